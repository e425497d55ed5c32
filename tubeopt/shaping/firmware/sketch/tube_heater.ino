// Heats a tube by its own resistance along a schedule, led by a thermometer. Written by `tubeopt heat firmware`: the
// schedule is in schedule.h, pins and board in board.h. The protocol on the serial line is one JSON object a line,
// 115200 baud: {"do":"start"}, {"do":"start","dry":true}, {"do":"stop"}, {"do":"status"}.
#include "heater.h"

void setup() { heater_begin(); }

void loop() { heater_loop(); }
