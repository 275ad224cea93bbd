#ifndef LIGHTSTAGE_EEPROM_H
#define LIGHTSTAGE_EEPROM_H

#include <cstdint>
#include <cstring>

struct Eeprom {
    uint8_t bytes[64];

    template <typename Value> void get(int place, Value &value) {
        std::memcpy(&value, bytes + place, sizeof value);
    }
    template <typename Value> void put(int place, const Value &value) {
        std::memcpy(bytes + place, &value, sizeof value);
    }
};

extern Eeprom EEPROM;

#endif
