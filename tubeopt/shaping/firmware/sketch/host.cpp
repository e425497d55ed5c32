// The heater on a computer, in step with a model of the rig: one line in for every tick, answers out.
//   in:   milliseconds degC(or nan) volt ampere_on ampere_off button reset [command]
//   out:  lines of the serial port, then "= count hold fed": ticks hold the cut-out, and the watchdog was fed.
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "hardware.h"
#include "heater.h"

namespace {
unsigned long clock_ms = 0;
float celsius = 25, volt = 12, on = 0, off = 0;
int button = 0, count = 255, hold = 1, fed = 0; // Until somebody switches it off.
char waiting[160];
size_t at = 0;
} // namespace

void hardware_begin() {}
uint32_t hardware_milliseconds() { return (uint32_t)clock_ms; }
void hardware_switch(uint8_t value) { count = value; }
bool hardware_temperature(float *value) {
  *value = celsius;
  return !isnan(celsius);
}
bool hardware_electrics(float *v, float *a, float *b) {
  *v = volt, *a = on, *b = off;
  return !isnan(volt);
}
bool hardware_emergency() { return button != 0; }
void hardware_hold(bool closed) { hold = closed; }
void hardware_alive() { fed = 1; }
bool hardware_was_reset_by_watchdog() { return getenv("RESET_BY_WATCHDOG") != nullptr; }
int hardware_read() { return waiting[at] ? waiting[at++] : -1; }
void hardware_write(const char *text) { fputs(text, stdout); }

int main() {
  heater_begin();
  printf("= %d %d %d\n", count, hold, fed);
  fflush(stdout);
  char line[320];
  while (fgets(line, sizeof line, stdin)) {
    int used = 0;
    char temperature[32], battery[32];
    if (sscanf(line, "%lu %31s %31s %f %f %d %n", &clock_ms, temperature, battery, &on, &off, &button, &used) < 6) return 2;
    celsius = (float)atof(temperature), volt = (float)atof(battery);
    snprintf(waiting, sizeof waiting, "%s", line + used);
    at = 0, fed = 0;
    heater_loop();
    printf("= %d %d %d\n", count, hold, fed);
    fflush(stdout);
  }
  return 0;
}
