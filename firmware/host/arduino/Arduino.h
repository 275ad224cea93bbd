/* As much of the Arduino API as the sketch uses, for a compiler without its tools. */

#ifndef LIGHTSTAGE_ARDUINO_H
#define LIGHTSTAGE_ARDUINO_H

#include <cstddef>
#include <cstdint>

enum { LOW = 0, HIGH = 1, OUTPUT = 1 };

void pinMode(uint8_t pin, uint8_t mode);
void digitalWrite(uint8_t pin, uint8_t value);
unsigned long millis();
unsigned long micros();
void delay(unsigned long ms);

struct SerialPort {
    void begin(unsigned long baud);
    int available();
    int read();
    int availableForWrite();
    size_t write(uint8_t byte);
};

extern SerialPort Serial;

void setup();
void loop();

#endif
