#ifndef WATCHDOG_H
#define WATCHDOG_H

#include <stdint.h>

void watchdog_enable(uint32_t milliseconds, bool pause_on_debug);
bool watchdog_caused_reboot();
void watchdog_update();

#endif
