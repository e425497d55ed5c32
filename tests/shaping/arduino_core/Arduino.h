// As much of an Arduino core as the heater takes, on a computer: pins and times are those of core.cpp.
#ifndef ARDUINO_H
#define ARDUINO_H

#include <stdint.h>

enum { INPUT_PULLUP = 2, OUTPUT = 1, HIGH = 1, LOW = 0 };
constexpr uint8_t A0 = 54, A1 = 55, A2 = 56;

void pinMode(uint8_t pin, uint8_t mode);
void digitalWrite(uint8_t pin, uint8_t value);
int digitalRead(uint8_t pin);
int analogRead(uint8_t pin);
unsigned long millis();
unsigned long micros();

#if defined(ARDUINO_ARCH_ESP32)
bool ledcAttach(uint8_t pin, uint32_t frequency, uint8_t bits);
bool ledcWrite(uint8_t pin, uint32_t duty);
#else
void analogWriteFreq(uint32_t frequency);
void analogWriteRange(uint32_t range);
void analogWrite(int pin, int value);
void analogReadResolution(int bits);
void tone(uint8_t pin, unsigned frequency);
void noTone(uint8_t pin);
#endif

struct SerialPort {
  void begin(unsigned long baud);
  int read();
  void print(const char *text);
};
extern SerialPort Serial;

#endif
