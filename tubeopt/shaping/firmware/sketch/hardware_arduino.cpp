// ESP32 and Raspberry Pi Pico by their Arduino cores. Pins are in board.h; a count is 1/255 of a period, whatever the
// board's own steps are.
#if defined(ARDUINO) && (defined(ARDUINO_ARCH_ESP32) || defined(ARDUINO_ARCH_RP2040))

#include <Arduino.h>
#include <SPI.h>

#include "board.h"
#include "converter.h"
#include "hardware.h"

#if defined(ARDUINO_ARCH_ESP32)
#include <esp_system.h>
#include <esp_task_wdt.h>
#else
#include <hardware/watchdog.h>
#endif

namespace {
constexpr uint32_t STEPS = 4080; // 16 for every count: below 4096, the 12 bits that both boards have at this frequency.
constexpr uint32_t TICK_HZ = 20000; // Several ticks in the shortest pause of the pulses.
bool by_watchdog = false;
} // namespace

void hardware_begin() {
  pinMode(PIN_GATE, OUTPUT);
  digitalWrite(PIN_GATE, LOW);
  pinMode(PIN_TICK, OUTPUT);
  digitalWrite(PIN_TICK, LOW);
  pinMode(PIN_STOP, INPUT_PULLUP);
  pinMode(PIN_SELECT, OUTPUT);
  digitalWrite(PIN_SELECT, HIGH);
  Serial.begin(115200);
  SPI.begin();
#if defined(ARDUINO_ARCH_ESP32)
  by_watchdog = esp_reset_reason() == ESP_RST_TASK_WDT || esp_reset_reason() == ESP_RST_WDT;
  const esp_task_wdt_config_t watch = {.timeout_ms = 500, .idle_core_mask = 0, .trigger_panic = true};
  esp_task_wdt_reconfigure(&watch);
  esp_task_wdt_add(nullptr);
  ledcAttach(PIN_GATE, (uint32_t)PWM_HZ, 12);
  ledcWrite(PIN_GATE, 0);
  ledcAttach(PIN_TICK, TICK_HZ, 8);
#else
  by_watchdog = watchdog_caused_reboot();
  analogWriteFreq((uint32_t)PWM_HZ);
  analogWriteRange(STEPS);
  analogReadResolution(10);
  watchdog_enable(500, true);
#endif
}

uint32_t hardware_milliseconds() { return millis(); }

void hardware_switch(uint8_t count) {
#if defined(ARDUINO_ARCH_ESP32)
  // 12 bits have 4096 steps: 255 counts are always on.
  ledcWrite(PIN_GATE, ((uint32_t)count * 4096 + 127) / 255);
#else
  analogWrite(PIN_GATE, (int)(count * (STEPS / 255)));
#endif
}

// A board that hangs is reset by its watchdog within half a second: then the ticks end too.
void hardware_hold(bool closed) {
#if defined(ARDUINO_ARCH_ESP32)
  ledcWrite(PIN_TICK, closed ? 128 : 0);
#else
  static bool ticking = false;
  if (closed && !ticking) tone(PIN_TICK, TICK_HZ);
  if (!closed) noTone(PIN_TICK);
  ticking = closed;
#endif
}

namespace {

bool read_temperature(float *celsius) {
#if SENSOR == SENSOR_ANALOG
  return decoded(analogRead(PIN_TEMPERATURE), celsius);
#else
  SPI.beginTransaction(SPISettings(1000000, MSBFIRST, SENSOR == SENSOR_MAX6675 ? SPI_MODE1 : SPI_MODE0));
  digitalWrite(PIN_SELECT, LOW);
  const uint16_t high = SPI.transfer16(0);
  const uint16_t low = SENSOR == SENSOR_MAX31855 ? SPI.transfer16(0) : 0;
  digitalWrite(PIN_SELECT, HIGH);
  SPI.endTransaction();
  return decoded(high, low, celsius);
#endif
}

} // namespace

bool hardware_temperature(float *celsius) { return when_ready(read_temperature, millis(), celsius); }

bool hardware_electrics(float *volt, float *ampere_on, float *ampere_off) {
  *volt = *ampere_on = *ampere_off = 0;
#if MEASURES_ELECTRICS
  // Over two periods: the most is what flows while the switch conducts, the least what flows while it does not.
  int most = 0, least = ANALOG_STEPS, highest = 0;
  const uint32_t span = (uint32_t)(2e6f / PWM_HZ), begin = micros();
  do {
    const int now = analogRead(PIN_CURRENT);
    if (now > most) {
      most = now;
      highest = analogRead(PIN_VOLTAGE);
    }
    if (now < least) least = now;
  } while (micros() - begin < span);
  *volt = highest * VOLT_PER_STEP;
  *ampere_on = (most - AMPERE_ZERO) * AMPERE_PER_STEP;
  *ampere_off = (least - AMPERE_ZERO) * AMPERE_PER_STEP;
#endif
  return MEASURES_ELECTRICS;
}

bool hardware_emergency() { return digitalRead(PIN_STOP) == HIGH; }

void hardware_alive() {
#if defined(ARDUINO_ARCH_ESP32)
  esp_task_wdt_reset();
#else
  watchdog_update();
#endif
}

bool hardware_was_reset_by_watchdog() { return by_watchdog; }

int hardware_read() { return Serial.read(); }

void hardware_write(const char *text) { Serial.print(text); }

#endif
