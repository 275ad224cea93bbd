#ifndef LIGHTSTAGE_SPI_H
#define LIGHTSTAGE_SPI_H

#include <cstdint>

enum { MSBFIRST = 1, SPI_MODE0 = 0 };

struct SPISettings {
    SPISettings(uint32_t clock_hz, uint8_t order, uint8_t mode);
};

struct SpiBus {
    void begin();
    void beginTransaction(SPISettings settings);
    uint8_t transfer(uint8_t byte);
    void endTransaction();
};

extern SpiBus SPI;

#endif
