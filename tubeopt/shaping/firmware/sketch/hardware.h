// What a board must do for the heater. Every call returns at once.
#ifndef HARDWARE_H
#define HARDWARE_H

#include <stdint.h>

void hardware_begin();
uint32_t hardware_milliseconds();

// Duty of the MOSFET: on for count / 255 of the time. 0 is off, and off at once.
void hardware_switch(uint8_t count);

// Ticks that hold the cut-out closed, for a quarter of a second from this call; or none from now on.
void hardware_hold(bool closed);

// The tube, degC. False where the thermometer answers nothing that could be true.
bool hardware_temperature(float *celsius);

// The voltage behind the cut-out and the current while the MOSFET conducts, and the current while it does not. False where the
// board does not measure them: what they would show is then not watched.
bool hardware_electrics(float *volt, float *ampere_on, float *ampere_off);

// Whether the stop button is pressed (or its wire broken).
bool hardware_emergency();

// The board resets itself where this is not called for half a second.
void hardware_alive();
bool hardware_was_reset_by_watchdog();

// Serial line: a byte, or -1 where none waits; and text.
int hardware_read();
void hardware_write(const char *text);

#endif
