/* A board that the sketch runs on: stdin and stdout are records as in ../bench.c.

   in:  b N bytes   come on the serial port
        c MS        the clock shows MS milliseconds
        z ID        reset; the EEPROM keeps ID where it is not 0
   out: r N bytes   were sent on the serial port
        l N bytes   a chain of TLC5947 shines so: 12 bits a channel, u16 little endian; zeros while
                    BLANK is high
        d 0         the record was dealt with */

#include <cstdio>
#include <cstdlib>
#include <vector>

#include "../../lightstage_leds/src/limits.h"
#include "Arduino.h"
#include "EEPROM.h"
#include "SPI.h"

static const int BLANK = 9, LATCH = 10;
static const size_t CHANNELS = (LS_LIGHTS + 23) / 24 * 24;

SerialPort Serial;
SpiBus SPI;
Eeprom EEPROM;

static std::vector<uint8_t> arrived, sent, shifted, latched(CHANNELS * 3 / 2);
static size_t next_byte;
static unsigned long clock_ms;
static bool pins[32], outputs[32], in_transaction;

static void tell(char letter, const std::vector<uint8_t> &data) {
    std::putchar(letter);
    for (unsigned shift = 0; shift < 32; shift += 8) {
        std::putchar(static_cast<int>(data.size() >> shift & 0xFF));
    }
    std::fwrite(data.data(), 1, data.size(), stdout);
}

/* Bit 287 of a chip is the highest of its output 23; what was shifted in first went farthest. */
static void show() {
    std::vector<uint8_t> levels;
    for (size_t channel = 0; channel < CHANNELS; channel++) {
        unsigned level = 0;
        for (size_t bit = 0; bit < 12; bit++) {
            size_t place = (CHANNELS - 1 - channel) * 12 + bit;
            level = level << 1 | (latched[place / 8] >> (7 - place % 8) & 1U);
        }
        level = pins[BLANK] ? 0 : level;
        levels.push_back(static_cast<uint8_t>(level & 0xFF));
        levels.push_back(static_cast<uint8_t>(level >> 8));
    }
    tell('l', levels);
}

void pinMode(uint8_t pin, uint8_t mode) {
    outputs[pin] = mode == OUTPUT;
}

void digitalWrite(uint8_t pin, uint8_t value) {
    bool rises = value == HIGH && !pins[pin];
    pins[pin] = value == HIGH;
    if (!outputs[BLANK] || !outputs[LATCH]) {
        return; /* a pull-up holds BLANK */
    }
    if (pin == LATCH && rises) {
        for (size_t byte = 0; byte < latched.size(); byte++) {
            latched[byte] = shifted[shifted.size() - latched.size() + byte];
        }
    }
    if (pin == BLANK) {
        show();
    }
}

unsigned long millis() { return clock_ms; }
unsigned long micros() { return 1000 * clock_ms; }
void delay(unsigned long ms) { clock_ms += ms; }

void SerialPort::begin(unsigned long) {}
int SerialPort::available() { return static_cast<int>(arrived.size() - next_byte); }
int SerialPort::read() { return arrived[next_byte++]; }
int SerialPort::availableForWrite() { return 63; }
size_t SerialPort::write(uint8_t byte) {
    sent.push_back(byte);
    return 1;
}

SPISettings::SPISettings(uint32_t, uint8_t, uint8_t) {}
void SpiBus::begin() {}
void SpiBus::beginTransaction(SPISettings) { in_transaction = true; }
void SpiBus::endTransaction() { in_transaction = false; }
uint8_t SpiBus::transfer(uint8_t byte) {
    if (!in_transaction) {
        std::abort();
    }
    shifted.push_back(byte);
    return 0;
}

int main() {
    uint8_t head[5];
    while (std::fread(head, 1, sizeof head, stdin) == sizeof head) {
        uint32_t number = head[1] | static_cast<uint32_t>(head[2]) << 8 |
                          static_cast<uint32_t>(head[3]) << 16 |
                          static_cast<uint32_t>(head[4]) << 24;
        arrived.assign(head[0] == 'b' ? number : 0, 0);
        next_byte = 0;
        if (std::fread(arrived.data(), 1, arrived.size(), stdin) != arrived.size()) {
            return 0;
        }
        if (head[0] == 'c') {
            clock_ms = number;
        } else if (head[0] == 'z') {
            if (number != 0) {
                EEPROM.put(0, number);
            }
            setup();
        }
        do {
            loop();
        } while (Serial.available() > 0);
        tell('r', sent);
        sent.clear();
        shifted.clear();
        tell('d', sent);
        std::fflush(stdout);
    }
    return 0;
}
