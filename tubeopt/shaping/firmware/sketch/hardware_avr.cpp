// Arduino Uno and Nano (ATmega328P, 16 MHz), by registers alone: it compiles in the Arduino IDE and with avr-gcc.
//   pin 9  (OC1A)  gate driver of the MOSFET; PWM by timer 1, phase-correct, 8 bits: a count is 1/255 of a period
//   pin 8          tick that retriggers the monostable of the cut-out, in every pause of the pulses
//   pin 10 (SS)    chip select of the thermocouple's converter; 12 (MISO) its data, 13 (SCK) its clock
//   pin 2          stop button to ground, normally closed: pressed or cut, it reads high
//   A0, A1, A2     battery voltage, current, analog temperature
#if defined(__AVR_ATmega328P__)

#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/wdt.h>

#include "board.h"
#include "converter.h"
#include "hardware.h"

namespace {

volatile uint32_t milliseconds = 0;
bool by_watchdog = false;

// Timer 1 counts up and down; a pulse is centred where it is 0, and far from it where it is at the top.
volatile uint16_t raw_volt = 0, raw_on = 0, raw_off = 0;
enum Sample : uint8_t { NOTHING, VOLT, ON, OFF };
volatile Sample sampling = NOTHING;
volatile bool current_next = true;

// A quarter of a second without a call of hardware_hold ends the ticks; there are two at every top of timer 1.
constexpr uint16_t HOLD_TICKS = (uint16_t)(0.5f * PWM_HZ);
volatile uint16_t hold_ticks = 0;

constexpr uint8_t PRESCALER = PWM_PRESCALER == 1024 ? _BV(CS12) | _BV(CS10)
                              : PWM_PRESCALER == 256 ? _BV(CS12)
                                                     : _BV(CS11) | _BV(CS10);

void convert(uint8_t channel) {
  ADMUX = _BV(REFS0) | channel;
  ADCSRA |= _BV(ADSC);
}

#if SENSOR != SENSOR_ANALOG
uint16_t spi_word(uint8_t bytes, uint16_t *low) {
  uint16_t high = 0;
  PORTB &= ~_BV(PB2);
  for (uint8_t k = 0; k < bytes; ++k) {
    SPDR = 0;
    while (!(SPSR & _BV(SPIF))) {
    }
    if (k < 2) high = (high << 8) | SPDR;
    else *low = (*low << 8) | SPDR;
  }
  PORTB |= _BV(PB2);
  return high;
}
#endif

} // namespace

// Bytes arrive while a report is sent, which takes some 15 ms.
volatile uint8_t arrived[64];
volatile uint8_t read_from = 0, read_to = 0;

ISR(USART_RX_vect) {
  const uint8_t byte = UDR0, next = (read_to + 1) % sizeof arrived;
  if (next != read_from) {
    arrived[read_to] = byte;
    read_to = next;
  }
}

ISR(TIMER2_COMPA_vect) { ++milliseconds; }

ISR(TIMER1_OVF_vect) {
  // Current and voltage in turns: the converter holds what it sees some 20 us after its start, but a second conversion
  // would begin 0.1 ms later, when a pulse of few counts is over.
  if (sampling == NOTHING) {
    sampling = current_next ? ON : VOLT;
    convert(current_next ? 1 : 0);
    current_next = !current_next;
  }
}

ISR(TIMER1_COMPB_vect) {
  if (hold_ticks) {
    --hold_ticks;
    PORTB |= _BV(PB0);
    for (uint8_t k = 0; k < 40; ++k) __asm__ volatile("nop"); // some 10 us, for any gate
    PORTB &= ~_BV(PB0);
  }
  if (sampling == NOTHING) {
    sampling = OFF;
    convert(1);
  }
}

ISR(ADC_vect) {
  const uint16_t value = ADC;
  if (sampling == VOLT) raw_volt = value;
  else if (sampling == ON) raw_on = value;
  else if (value > raw_off) raw_off = value;
  sampling = NOTHING;
}

void hardware_begin() {
  by_watchdog = MCUSR & _BV(WDRF);
  MCUSR = 0;
  wdt_enable(WDTO_500MS);
  cli();
  PORTB &= ~(_BV(PB0) | _BV(PB1));
  DDRB |= _BV(PB0) | _BV(PB1) | _BV(PB2) | _BV(PB5); // tick, gate, chip select, clock
  PORTB |= _BV(PB2);
  PORTD |= _BV(PD2); // pull-up of the stop button
  // Timer 1: phase-correct, 8 bits; samples at the bottom (in the pulse) and near the top (between pulses).
  TCCR1A = _BV(WGM10);
  TCCR1B = PRESCALER;
  OCR1A = 0;
  OCR1B = 254;
  TIMSK1 = _BV(TOIE1) | _BV(OCIE1B);
  // Timer 2: a millisecond.
  TCCR2A = _BV(WGM21);
  TCCR2B = _BV(CS22);
  OCR2A = 249;
  TIMSK2 = _BV(OCIE2A);
  ADCSRA = _BV(ADEN) | _BV(ADIE) | _BV(ADPS2) | _BV(ADPS1) | _BV(ADPS0);
  SPCR = _BV(SPE) | _BV(MSTR) | _BV(SPR0) | (SENSOR == SENSOR_MAX6675 ? _BV(CPHA) : 0);
  UCSR0A = _BV(U2X0);
  UBRR0 = 16; // 115200 baud
  UCSR0C = _BV(UCSZ01) | _BV(UCSZ00);
  UCSR0B = _BV(RXEN0) | _BV(TXEN0) | _BV(RXCIE0);
  sei();
}

uint32_t hardware_milliseconds() {
  const uint8_t status = SREG;
  cli();
  const uint32_t now = milliseconds;
  SREG = status;
  return now;
}

void hardware_switch(uint8_t count) {
  if (count == 0) {
    // The pin is taken from the timer: off at once, not at the end of the period.
    TCCR1A &= ~_BV(COM1A1);
    PORTB &= ~_BV(PB1);
  } else TCCR1A |= _BV(COM1A1);
  OCR1A = count;
}

void hardware_hold(bool closed) {
  const uint8_t status = SREG;
  cli();
  hold_ticks = closed ? HOLD_TICKS : 0;
  SREG = status;
}

namespace {

bool read_temperature(float *celsius) {
#if SENSOR != SENSOR_ANALOG
  uint16_t low = 0;
  const uint16_t high = spi_word(SENSOR == SENSOR_MAX31855 ? 4 : 2, &low);
  return decoded(high, low, celsius);
#else
  // The converter is shared with the pulses' samples: wait for its turn, some 0.2 ms.
  for (;;) {
    cli();
    if (sampling == NOTHING) break;
    sei();
  }
  ADCSRA &= ~_BV(ADIE);
  convert(2);
  while (ADCSRA & _BV(ADSC)) {
  }
  const uint16_t value = ADC;
  ADCSRA |= _BV(ADIF);
  ADCSRA |= _BV(ADIE);
  sei();
  return decoded(value, celsius);
#endif
}

} // namespace

bool hardware_temperature(float *celsius) { return when_ready(read_temperature, hardware_milliseconds(), celsius); }

bool hardware_electrics(float *volt, float *ampere_on, float *ampere_off) {
  const uint8_t status = SREG;
  cli();
  const uint16_t v = raw_volt, on = raw_on, off = raw_off;
  raw_off = 0; // The greatest since the last call: the cut-out may have ended it.
  SREG = status;
  *volt = v * VOLT_PER_STEP;
  *ampere_on = ((int16_t)on - AMPERE_ZERO) * AMPERE_PER_STEP;
  *ampere_off = ((int16_t)off - AMPERE_ZERO) * AMPERE_PER_STEP;
  return MEASURES_ELECTRICS;
}

bool hardware_emergency() { return PIND & _BV(PD2); }

void hardware_alive() { wdt_reset(); }

bool hardware_was_reset_by_watchdog() { return by_watchdog; }

int hardware_read() {
  if (read_from == read_to) return -1;
  const uint8_t byte = arrived[read_from];
  read_from = (read_from + 1) % sizeof arrived;
  return byte;
}

void hardware_write(const char *text) {
  for (; *text; ++text) {
    while (!(UCSR0A & _BV(UDRE0))) {
    }
    UDR0 = *text;
  }
}

#ifndef ARDUINO
#include "heater.h"

int main() {
  heater_begin();
  for (;;) heater_loop();
}
#endif

#endif
