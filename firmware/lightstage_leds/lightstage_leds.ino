/* An LED device on an Arduino or a Teensy whose lamps hang on a chain of TLC5947 (24 lamps each, 12
   bits; Texas Instruments, SBVS114). ../README.md has the wiring, and what was tried.

   Other lamps: write another write_lamps(). All else stays. */

#include <EEPROM.h>
#include <SPI.h>
#ifdef __AVR__
#include <avr/wdt.h>
#endif

#include "src/device.h"

/* High turns all lamps off. A resistor pulls it up, so that they are off while the board resets. */
static const uint8_t BLANK_PIN = 9;
static const uint8_t LATCH_PIN = 10;
/* The chips may be clocked with up to 15 MHz in a chain; long wires want less. */
static const uint32_t CLOCK_HZ = 2000000;

static const uint16_t CHANNELS = (LS_LIGHTS + 23) / 24 * 24;
static const uint16_t FULL_STEP = 4095;
/* The lamps have begun a new pulse by then. */
static const uint8_t SETTLE_MS = 1;

#ifdef __AVR__
/* Exact at 16 MHz, and slow enough: a byte takes an ATmega up to 460 of its 640 cycles. */
static const uint32_t BAUD = 250000;
#else
static const uint32_t BAUD = 921600;
#endif
/* A port whose host does not read loses bytes after so long; the host asks again. */
static const uint32_t LINE_WAIT_US = 500;

static const int BOOT_ID_ADDRESS = 0;

static ls_device device;

static uint16_t step_of(const uint16_t *levels, uint16_t channel) {
    if (channel >= LS_LIGHTS) {
        return 0;
    }
    return (uint16_t)(((uint32_t)levels[channel] * FULL_STEP + 32767) / 65535);
}

static void write_lamps(void *, const uint16_t *levels) {
    bool lit = false;
    SPI.beginTransaction(SPISettings(CLOCK_HZ, MSBFIRST, SPI_MODE0));
    /* What is sent first goes to the end of the chain. Two lamps are three bytes. */
    for (uint16_t channel = CHANNELS; channel > 0; channel -= 2) {
        uint16_t high = step_of(levels, channel - 1);
        uint16_t low = step_of(levels, channel - 2);
        SPI.transfer((uint8_t)(high >> 4));
        SPI.transfer((uint8_t)((high & 15) << 4 | low >> 8));
        SPI.transfer((uint8_t)(low & 0xFF));
        lit = lit || high > 0 || low > 0;
    }
    SPI.endTransaction();
    digitalWrite(BLANK_PIN, HIGH);
    digitalWrite(LATCH_PIN, HIGH);
    digitalWrite(LATCH_PIN, LOW);
    digitalWrite(BLANK_PIN, lit ? LOW : HIGH);
    delay(SETTLE_MS);
}

static void write_byte(void *, uint8_t byte) {
    uint32_t since = micros();
    while (Serial.availableForWrite() <= 0) {
        if (micros() - since >= LINE_WAIT_US) {
            return;
        }
    }
    Serial.write(byte);
}

static uint32_t milliseconds(void *) {
    return millis();
}

/* Another one after each reset: counted where it outlives the power. */
static uint32_t next_boot_id() {
    uint32_t id = 0;
    EEPROM.get(BOOT_ID_ADDRESS, id);
    id++;
    EEPROM.put(BOOT_ID_ADDRESS, id);
    return id;
}

/* The processor's own watchdog: a program that hangs is reset, and BLANK is pulled up then. */
static void stop_own_watchdog() {
#ifdef __AVR__
    /* Else it goes on after a reset of its own, with its shortest time. */
    MCUSR = 0;
    wdt_disable();
#endif
}

static void start_own_watchdog() {
#ifdef __AVR__
    wdt_enable(WDTO_500MS);
#endif
}

static void tell_own_watchdog() {
#ifdef __AVR__
    wdt_reset();
#endif
}

void setup() {
    stop_own_watchdog();
    digitalWrite(BLANK_PIN, HIGH);
    pinMode(BLANK_PIN, OUTPUT);
    digitalWrite(LATCH_PIN, LOW);
    pinMode(LATCH_PIN, OUTPUT);
    SPI.begin();
    Serial.begin(BAUD);
    ls_hardware hardware = {write_lamps, NULL, write_byte, milliseconds, NULL};
    ls_begin(&device, &hardware, next_boot_id());
    start_own_watchdog();
}

void loop() {
    /* A line that never rests must not keep the loop from its end. */
    for (uint8_t left = 64; left > 0 && Serial.available() > 0; left--) {
        ls_take(&device, (uint8_t)Serial.read());
    }
    ls_tick(&device);
    tell_own_watchdog();
}
