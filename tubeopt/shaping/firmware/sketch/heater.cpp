#include "heater.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "board.h"
#include "hardware.h"
#include "schedule.h"

namespace {

const char *const STATES[] = {"idle", "testing", "heating", "holding", "stopped"};
const char *const STOPS[] = {
    "",
    "done",
    "stopped by command",
    "emergency stop",
    "watchdog",
    "thermometer broken",
    "thermometer stuck",
    "over-temperature",
    "over-current",
    "no current",
    "switch stuck",
    "cut-out stuck",
    "low battery",
    "behind schedule",
    "too cold",
    "maximum time",
};

// --- what is remembered -------------------------------------------------------------------------------------------------

// All of it is 0 when the board starts.
State state = IDLE;
Stop reason = NOT_STOPPED;
bool dry;  // Everything but the current: the MOSFET stays off.

uint8_t table;   // Schedule for the battery's voltage at rest.
uint16_t place;  // Slot of the schedule.
float total;     // Integral share.
float owed;      // Counts that rounding left out.
uint32_t waited; // ms for which the schedule waited for the tube.
uint8_t count;

uint32_t started, next_tick;
uint8_t ticks; // Of this slot, or of the test.
bool bench;    // The test ends with the cut-out opened under pulses.
uint32_t released;

// What a computer wants of the next slots, in counts, and how many are left of them.
float lead, lead_step;
uint8_t led;

float reading, volt, ampere, leaking;
bool electrics;
float stuck_at;
uint32_t stuck_since;
float missed_rise; // K that the schedule rose since the reading moved.
uint8_t bad_readings, bad_currents;
Stop first_wrong;

// --- reports ------------------------------------------------------------------------------------------------------------

// printf of an AVR knows no floats. `text` has room for 16 characters.
const char *fixed(char *text, float value, uint8_t digits) {
  char reversed[16];
  uint8_t length = 0;
  for (uint8_t k = 0; k < digits; ++k) value *= 10;
  long whole = lroundf(value);
  const bool negative = whole < 0;
  if (negative) whole = -whole;
  do {
    if (digits && length == digits) reversed[length++] = '.';
    reversed[length++] = (char)('0' + whole % 10);
    whole /= 10;
  } while ((whole || length <= digits) && length < 13);
  uint8_t at = 0;
  if (negative) text[at++] = '-';
  while (length) text[at++] = reversed[--length];
  text[at] = 0;
  return text;
}

void tell_status() {
  char line[208], a[16], b[16], c[16], d[16], e[16];
  const float time = state == IDLE ? 0 : (hardware_milliseconds() - started) / 1000.0f;
  snprintf(line, sizeof line,
           "{\"event\":\"status\",\"state\":\"%s\",\"time_s\":%s,\"temperature_degC\":%s,\"reference_degC\":%s,"
           "\"count\":%u,",
           STATES[state], fixed(a, time, 1), fixed(b, reading, 2), fixed(c, reference_at(place), 1), count);
  hardware_write(line);
  snprintf(line, sizeof line, "\"place\":%u,\"voltage_V\":%s,\"current_A\":%s,\"reason\":\"%s\",\"dry\":%s,\"led\":%s}\n", place,
           electrics ? fixed(d, volt, 2) : "null", electrics ? fixed(e, ampere, 1) : "null", STOPS[reason],
           dry ? "true" : "false", led ? "true" : "false");
  hardware_write(line);
}

void tell_error(const char *text) {
  hardware_write("{\"event\":\"error\",\"text\":\"");
  hardware_write(text);
  hardware_write("\"}\n");
}

void tell_hello() {
  char line[160];
  snprintf(line, sizeof line,
           "{\"event\":\"hello\",\"firmware\":\"tubeopt heater\",\"schedule\":\"%s\",\"slots\":%u,\"slot_ms\":%u,"
           "\"window_degC\":[%d,%d]}\n",
           SCHEDULE_ID, SLOTS, SLOT_MS, WINDOW_LOW, WINDOW_HIGH);
  hardware_write(line);
}

// The reading, corrected for the heat that flows along the wires of a thermocouple.
bool temperature(float *celsius) {
  const bool answers = hardware_temperature(celsius);
  *celsius += CORRECTION * (*celsius - CORRECTED_FROM);
  return answers;
}

// --- start and stop -----------------------------------------------------------------------------------------------------

void stop(Stop why) {
  count = 0;
  hardware_switch(0);
  hardware_hold(false);
  state = STOPPED;
  reason = why;
  released = 0;
  tell_status();
}

// The schedule for the highest voltage at rest that is not above the battery's; the one for the emptiest below them all.
uint8_t table_for(float rest) {
  uint8_t found = TABLES - 1;
  for (uint8_t k = TABLES; k-- > 0;)
    if (voltage_of(k) <= rest + 0.05f) found = k;
  return found;
}

bool running() { return state == TESTING || state == HEATING || state == HOLDING; }

// A start begins with the test of switch and cut-out.
void start(bool without_current, bool on_bench) {
  if (running()) return tell_error("it is heating");
  if (hardware_emergency()) return tell_error("the stop button is pressed");
  float seen = 0;
  if (!temperature(&seen) || seen <= LOWEST_READING) return tell_error("the thermometer answers nothing");
  reading = seen;
  if (reading > START_BELOW) return tell_error("the tube is still hot");
  electrics = hardware_electrics(&volt, &ampere, &leaking);
  // The pull-up across the open cut-out shows the battery, unless the switch shorts it.
  if (electrics && volt < LOWEST_VOLT / 2) return tell_error("no voltage: the switch is shorted, or the fuse is blown");
  if (electrics && volt < LOWEST_VOLT && !without_current) return tell_error("the battery is low");
  if (on_bench && !electrics) return tell_error("the board measures no current");
  dry = without_current;
  bench = on_bench;
  place = 0, total = 0, owed = 0, waited = 0, ticks = 0, led = 0, bad_readings = 0, bad_currents = 0;
  started = stuck_since = next_tick = hardware_milliseconds();
  stuck_at = reading;
  missed_rise = 0;
  reason = NOT_STOPPED;
  state = TESTING;
}

// What the parts of a start must show, one after the other, TEST_TICKS each: no current with pulses and an open cut-out;
// none with a closed one and no pulses; that of the tube with both. A dry run has no pulses.
Stop test() {
  const uint8_t part = ticks / TEST_TICKS;
  if (ticks % TEST_TICKS == 0) {
    const bool flows = electrics && (ampere > LEAKING_AMPERE || leaking > LEAKING_AMPERE);
    if (part == 1 && flows) return leaking > LEAKING_AMPERE ? SWITCH_STUCK : CUTOUT_STUCK;
    if (part == 2) {
      if (flows) return SWITCH_STUCK;
      if (electrics && volt < LOWEST_VOLT && !dry) return LOW_BATTERY;
      table = electrics ? table_for(volt) : 0;
    }
    if (part == 3) {
      if (electrics && !dry && ampere > MOST_AMPERE) return OVER_CURRENT;
      if (electrics && !dry && ampere < LEAST_AMPERE) return NO_CURRENT;
      started = stuck_since = hardware_milliseconds();
      stuck_at = reading;
      ticks = 0;
      if (bench) {
        released = hardware_milliseconds() | 1; // 0: not released
        hardware_hold(false);
      } else state = HEATING;
      return NOT_STOPPED;
    }
    count = part == 1 || dry ? 0 : TEST_COUNT;
    hardware_switch(count);
  }
  ++ticks;
  return NOT_STOPPED;
}

// The cut-out opens under pulses: the time until no current flows any more.
void watch_cutout() {
  electrics = hardware_electrics(&volt, &ampere, &leaking);
  const uint32_t span = hardware_milliseconds() - released;
  if (ampere > LEAKING_AMPERE || leaking > LEAKING_AMPERE) {
    if (span > CUTOUT_MS) stop(CUTOUT_STUCK);
    return;
  }
  char line[80];
  snprintf(line, sizeof line, "{\"event\":\"cutout\",\"opened_ms\":%lu,\"allowed_ms\":%u}\n", (unsigned long)span,
           CUTOUT_MS);
  hardware_write(line);
  stop(DONE);
}

// --- the law ------------------------------------------------------------------------------------------------------------

float clip(float value, float low, float high) { return value < low ? low : value > high ? high : value; }

// The count of the slot that begins: planned duty, corrected by a share that the error sets.
void decide() {
  if (place >= SLOTS) return stop(DONE);
  const float error = reference_at(place) - reading;
  // A reading that does not move may be that of a thermometer that lost touch: what was learnt before goes on.
  const bool still = place >= HOLD_FIRST && hardware_milliseconds() - stuck_since > STILL_MS;
  const float corrected = still ? 0 : error;
  // Without current the tube would never come to where the schedule waits for it.
  const bool behind = error > HOLDBACK && place <= HOLD_FIRST;
  const bool waits = !dry && (behind || (reading < HOLD_FLOOR && place >= HOLD_FIRST));
  if (waits) waited += SLOT_MS;
  if (waited > PATIENCE_MS) return stop(place >= HOLD_FIRST && !behind ? TOO_COLD : BEHIND_SCHEDULE);
  const float planned = planned_at(table, place);
  // The bare tube beside the clamps, which no thermometer sees, keeps its limit at BARE_COUNT.
  const float most = planned > 0 ? clip(BARE_COUNT / planned - 1, 0, SHARE) : SHARE;
  total = clip(total + INTEGRAL * (SLOT_MS / 1000.0f) * corrected, -SHARE, most);
  float share = clip(PROPORTIONAL * corrected + total, -SHARE, most);
  if (led) {
    // As far as the share allows; the sum becomes the one that would have said the same, and goes on from there.
    if (planned > 0) {
      share = clip(lead / planned - 1, -SHARE, most);
      total = clip(share - PROPORTIONAL * corrected, -SHARE, most);
    }
    lead += lead_step;
    --led;
  }
  const float wanted = share > -1 ? planned * (1 + share) : 0;
  const float due = wanted + owed;
  count = due > HALF ? (uint8_t)clip(floorf(due + LOST + 1 - HALF), 0, MOST_COUNT) : 0;
  const float given = count > LOST ? count - LOST : 0;
  owed = wanted > 0 ? clip(due - given, -1 - LOST, 1) : 0;
  state = place >= HOLD_FIRST ? HOLDING : HEATING;
  if (!waits) ++place;
  hardware_switch(dry ? 0 : count);
}

// Whether the reading stays where it is although the tube must move it. In the ramp it must rise, also while the schedule
// waits; in the hold nothing is seen of a thermometer that lost touch but that its reading flickers no more.
bool stuck(float seen, uint32_t now) {
  if (fabsf(seen - stuck_at) > STUCK_WITHIN || count == 0 || dry || state == TESTING) {
    stuck_at = seen;
    stuck_since = now;
    missed_rise = 0;
  } else missed_rise += (reference_at(place + 1) - reference_at(place)) * TICK_MS / SLOT_MS;
  const uint32_t span = now - stuck_since;
  return span > STUCK_HOLDING_MS || (span > STUCK_MS && missed_rise > STUCK_RISE);
}

// --- what must never be -------------------------------------------------------------------------------------------------

Stop danger() {
  float seen = 0;
  const bool answers = temperature(&seen);
  if (hardware_emergency()) return EMERGENCY;
  // One bad answer is a spark on the wire, three in a row are a broken thermometer.
  bad_readings = answers && seen > LOWEST_READING && seen < HIGHEST_READING ? 0 : bad_readings < 3 ? bad_readings + 1 : 3;
  if (bad_readings >= 3 && running()) return THERMOMETER_BROKEN;
  const uint32_t now = hardware_milliseconds();
  if (!bad_readings) {
    reading = seen;
    if (reading > TOO_HOT) return OVER_TEMPERATURE;
    if (stuck(seen, now)) return THERMOMETER_STUCK;
  }
  electrics = hardware_electrics(&volt, &ampere, &leaking);
  const bool off = dry || !running();
  if (electrics) {
    Stop wrong = NOT_STOPPED;
    if (ampere > MOST_AMPERE) wrong = OVER_CURRENT;
    else if (leaking > LEAKING_AMPERE || (off && ampere > LEAKING_AMPERE)) wrong = SWITCH_STUCK;
    // A pulse of one count may be over before a converter has looked. The test sees to its own currents.
    else if (off || state == TESTING) wrong = NOT_STOPPED;
    else if (count > 1 && ampere < LEAST_AMPERE) wrong = NO_CURRENT;
    else if (volt < LOWEST_VOLT) wrong = LOW_BATTERY;
    // The first fault names the stop: after a short has opened the cut-out there is no current.
    if (bad_currents == 0) first_wrong = wrong;
    bad_currents = wrong == NOT_STOPPED ? 0 : bad_currents < 2 ? bad_currents + 1 : 2;
    if (bad_currents >= 2) return first_wrong;
  }
  if (running() && now - started > LONGEST_MS) return MAXIMUM_TIME;
  return NOT_STOPPED;
}

// --- commands -----------------------------------------------------------------------------------------------------------

// The number after a key; less than 0 where there is none.
long number(const char *line, const char *key) {
  const char *at = strstr(line, key);
  return at ? atol(at + strlen(key)) : -1;
}

// What the next slots shall be given, in a line from one hundredth of a count to another. Whatever it says stays within
// the share of the schedule; where no other comes in time, the law goes on alone.
void follow(const char *line) {
  const long slots = number(line, "\"slots\":"), from = number(line, "\"from\":"), to = number(line, "\"to\":");
  if (slots < 1 || slots > 20 || from < 0 || to < 0 || from > 25500 || to > 25500) return tell_error("a lead is wrong");
  led = (uint8_t)slots;
  lead = from / 100.0f;
  lead_step = slots > 1 ? (to - from) / 100.0f / (slots - 1) : 0;
}

void obey(const char *line) {
  if (strstr(line, "\"stop\"")) {
    if (running()) stop(BY_COMMAND);
    else tell_status();
  } else if (strstr(line, "\"lead\"")) follow(line);
  else if (strstr(line, "\"start\"")) start(strstr(line, "\"dry\":true") != nullptr, false);
  else if (strstr(line, "\"test\"")) start(false, true);
  else if (strstr(line, "\"status\"")) tell_status();
  else if (strstr(line, "\"hello\"")) tell_hello();
  else tell_error("a line is {\\\"do\\\":\\\"start\\\"}, or stop, status, hello, test in place of start");
}

void listen() {
  static char line[64];
  static uint8_t length = 0;
  for (int byte = hardware_read(); byte >= 0; byte = hardware_read()) {
    if (byte == '\n' || byte == '\r') {
      line[length] = 0;
      if (length) obey(line);
      length = 0;
    } else if (length < sizeof line - 1) line[length++] = (char)byte;
  }
}

} // namespace

void heater_begin() {
  hardware_begin();
  hardware_switch(0);
  hardware_hold(false);
  tell_hello();
  if (hardware_was_reset_by_watchdog()) {
    state = STOPPED;
    reason = WATCHDOG;
    tell_status();
  }
}

void heater_loop() {
  listen();
  if (released && state == TESTING) watch_cutout();
  const uint32_t now = hardware_milliseconds();
  // Signed, so that the clock may run over.
  if ((int32_t)(now - next_tick) < 0) return;
  // Watchdog and cut-out live by progress: a clock that stands still ends both, though this loop still turns.
  hardware_alive();
  next_tick = running() ? next_tick + TICK_MS : now + TICK_MS;
  const Stop why = danger();
  if (why != NOT_STOPPED) {
    if (why != reason) stop(why);
    return;
  }
  if (!running() || released) return;
  // In the first part of the test the cut-out is open.
  if (state != TESTING || ticks >= TEST_TICKS) hardware_hold(true);
  if (state == TESTING) {
    const Stop wrong = test();
    if (wrong != NOT_STOPPED) return stop(wrong);
    if (state == TESTING) return;
  }
  if (ticks == 0) {
    decide();
    if (state != STOPPED) tell_status();
  }
  ticks = (ticks + 1) % TICKS_PER_SLOT;
}
