// Readings of the converter of a thermometer on any board, and the time of the next reading.
#ifndef CONVERTER_H
#define CONVERTER_H

#include <stdint.h>

#include "board.h"

#if SENSOR == SENSOR_ANALOG
// From a step of the analog line; false at both ends, where it is cut or shorted.
static inline bool decoded(int step, float *celsius) {
  *celsius = ANALOG_ZERO + ANALOG_PER_STEP * step;
  return step > 2 && step < ANALOG_STEPS - 3;
}
#else
// From the words that were clocked in, the second of a MAX31855 alone; false if it reports a fault, or a wire is cut.
static inline bool decoded(uint16_t high, uint16_t low, float *celsius) {
#if SENSOR == SENSOR_MAX31855
  *celsius = (int16_t)high / 4 * 0.25f;
  return !(high & 1) && !(low & 7) && high != 0xffff && (high || low);
#else
  (void)low;
  *celsius = (high >> 3) * 0.25f;
  return !(high & 4) && high != 0xffff;
#endif
}
#endif

// A converter that is read before it is ready restarts its conversion and never finishes one.
static inline bool when_ready(bool (*read)(float *), uint32_t now, float *celsius) {
  static float last = 0;
  static bool well = false;
  static uint32_t next = 0;
  if ((int32_t)(now - next) >= 0) {
    well = read(&last);
    next = now + SENSOR_MS;
  }
  *celsius = last;
  return well;
}

#endif
