// The board on a computer, in step with a model of the rig, by the lines that host.cpp takes: what they say of the rig
// stands at the pins, and the count that is answered is read from the PWM.
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "Arduino.h"
#include "SPI.h"
#include "board.h"
#include "heater.h"
#if defined(ARDUINO_ARCH_ESP32)
#include "esp_system.h"
#include "esp_task_wdt.h"
#else
#include "hardware/watchdog.h"
#endif

static unsigned long clock_ms = 0, passed_us = 0;
static float celsius = 25, volt = 12, on = 0, off = 0;
static int button = 0, looks = 0;
static double duty = 0;
static long fed = 0;
static bool ticks = false;
static char waiting[160];
static size_t at = 0;
static int word = 0;

static void must(bool right, const char *what) {
  if (right) return;
  fprintf(stderr, "%s\n", what);
  exit(3);
}

void pinMode(uint8_t, uint8_t) {}
void digitalWrite(uint8_t pin, uint8_t) {
  if (pin == PIN_SELECT) word = 0;
}
int digitalRead(uint8_t pin) {
  must(pin == PIN_STOP, "reads another pin than the stop button");
  return button;
}
int analogRead(uint8_t pin) {
  if (pin == PIN_VOLTAGE) return (int)fminf(lroundf(volt / VOLT_PER_STEP), ANALOG_STEPS - 1);
  must(pin == PIN_CURRENT, "reads a pin that carries nothing");
  // Pulses come and go while it looks.
  return (int)lroundf((++looks / 3 % 2 ? on : off) / AMPERE_PER_STEP) + AMPERE_ZERO;
}
unsigned long millis() { return clock_ms; }
unsigned long micros() { return passed_us += 120; }

uint16_t SPIPort::transfer16(uint16_t) {
  if (isnan(celsius)) return 1;
  return word++ ? 0 : (uint16_t)((int)lroundf(celsius * 4) * 4);
}
SPIPort SPI;

void SerialPort::begin(unsigned long baud) { must(baud == 115200, "another baud rate"); }
int SerialPort::read() { return waiting[at] ? waiting[at++] : -1; }
void SerialPort::print(const char *text) { fputs(text, stdout); }
SerialPort Serial;

#if defined(ARDUINO_ARCH_ESP32)
static int bits_of_duty = 0;
bool ledcAttach(uint8_t pin, uint32_t frequency, uint8_t bits) {
  must(pin == PIN_TICK || (pin == PIN_GATE && frequency == (uint32_t)PWM_HZ), "another gate or frequency");
  if (pin == PIN_GATE) bits_of_duty = bits;
  return true;
}
bool ledcWrite(uint8_t pin, uint32_t value) {
  if (pin == PIN_TICK) {
    ticks = value > 0;
    return true;
  }
  must(pin == PIN_GATE, "switches another pin");
  duty = value / (double)(1u << bits_of_duty);
  return true;
}
esp_reset_reason_t esp_reset_reason() { return getenv("RESET_BY_WATCHDOG") ? ESP_RST_TASK_WDT : ESP_RST_POWERON; }
int esp_task_wdt_reconfigure(const esp_task_wdt_config_t *config) { return config->timeout_ms == 500 ? 0 : -1; }
int esp_task_wdt_add(void *) { return 0; }
int esp_task_wdt_reset() { return (int)++fed; }
#else
static uint32_t range_of_duty = 255;
void analogWriteFreq(uint32_t frequency) { must(frequency == (uint32_t)PWM_HZ, "another frequency"); }
void analogWriteRange(uint32_t range) { range_of_duty = range; }
void analogWrite(int pin, int value) {
  must(pin == PIN_GATE, "switches another pin");
  duty = value / (double)range_of_duty;
}
void analogReadResolution(int bits) { must(1 << bits == ANALOG_STEPS, "another resolution"); }
void tone(uint8_t pin, unsigned) { ticks = pin == PIN_TICK; }
void noTone(uint8_t) { ticks = false; }
void watchdog_enable(uint32_t milliseconds, bool) { must(milliseconds == 500, "another watchdog"); }
bool watchdog_caused_reboot() { return getenv("RESET_BY_WATCHDOG") != nullptr; }
void watchdog_update() { ++fed; }
#endif

static void answer() {
  printf("= %ld %d 1\n", lround(255 * duty), (int)ticks);
  fflush(stdout);
}

int main() {
  heater_begin();
  answer();
  char line[320];
  while (fgets(line, sizeof line, stdin)) {
    int used = 0;
    char temperature[32], battery[32];
    if (sscanf(line, "%lu %31s %31s %f %f %d %n", &clock_ms, temperature, battery, &on, &off, &button, &used) < 6) return 2;
    celsius = (float)atof(temperature), volt = (float)atof(battery);
    snprintf(waiting, sizeof waiting, "%s", line + used);
    at = 0;
    const long before = fed;
    heater_loop();
    must(fed > before, "the watchdog is not fed");
    answer();
  }
  return 0;
}
