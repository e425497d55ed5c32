#ifndef SPI_H
#define SPI_H

#include <stdint.h>

enum { MSBFIRST = 1, SPI_MODE0 = 0, SPI_MODE1 = 1 };
struct SPISettings {
  SPISettings(uint32_t, uint8_t, uint8_t) {}
};
struct SPIPort {
  void begin() {}
  void beginTransaction(SPISettings) {}
  void endTransaction() {}
  uint16_t transfer16(uint16_t);
};
extern SPIPort SPI;

#endif
