// The heating of a tube, led by a thermometer: everything but the board. The board is behind hardware.h.
#ifndef HEATER_H
#define HEATER_H

#include <stdint.h>

// What the heater does; `state` of its reports.
enum State : uint8_t { IDLE, TESTING, HEATING, HOLDING, STOPPED };

// Why it stopped; `reason` of its reports. MOSFET and cut-out are open in every one of them.
enum Stop : uint8_t {
  NOT_STOPPED,
  DONE,
  BY_COMMAND,
  EMERGENCY,
  WATCHDOG,
  THERMOMETER_BROKEN,
  THERMOMETER_STUCK,
  OVER_TEMPERATURE,
  OVER_CURRENT,
  NO_CURRENT,
  SWITCH_STUCK,
  CUTOUT_STUCK,
  LOW_BATTERY,
  BEHIND_SCHEDULE,
  TOO_COLD,
  MAXIMUM_TIME,
};

void heater_begin();
void heater_loop();

#endif
