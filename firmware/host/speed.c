/* How fast this computer does it: speed FRAMES. Prints SETs a second, and nanoseconds a byte. */

#define _XOPEN_SOURCE 600

#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include "../lightstage_leds/src/device.h"
#include "second_hand.h"

static void write_lamps(void *context, const uint16_t *levels) {
    (void)context;
    (void)levels;
}

static void write_byte(void *context, uint8_t byte) {
    *(unsigned long *)context += byte == 0;
}

static uint32_t milliseconds(void *context) {
    (void)context;
    return 0;
}

static double now_s(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

/* Seconds for so many frames of which the last byte but the closing zero is `spoilt` or not. */
static double measured(unsigned long frames, int spoilt, unsigned long *replies, size_t *size) {
    static ls_device device;
    static uint8_t packet[LS_BODY + 2];
    static uint8_t frame[LS_BODY + LS_BODY / 254 + 8];
    ls_hardware hardware = {write_lamps, NULL, write_byte, milliseconds, replies};
    packet[0] = LS_VERSION;
    packet[1] = 0x10;
    packet[4] = LS_LIGHTS & 0xFF;
    packet[5] = LS_LIGHTS >> 8;
    for (size_t place = 6; place < LS_BODY; place++) {
        packet[place] = (uint8_t)(37 * place);
    }
    ls_begin(&device, &hardware, 1);
    double taken_s = 0;
    for (unsigned long number = 1; number <= frames; number++) {
        packet[2] = (uint8_t)(number & 0xFF);
        packet[3] = (uint8_t)(number >> 8 & 0xFF);
        *size = put_together(packet, LS_BODY, frame);
        frame[*size - 2] ^= (uint8_t)(spoilt != 0);
        double begun_s = now_s();
        for (size_t place = 0; place < *size; place++) {
            ls_take(&device, frame[place]);
        }
        taken_s += now_s() - begun_s;
    }
    return taken_s;
}

int main(int argc, char **argv) {
    unsigned long frames = argc > 1 ? strtoul(argv[1], NULL, 10) : 20000;
    unsigned long answered = 0;
    unsigned long refused = 0;
    size_t size = 0;
    double whole_s = measured(frames, 0, &answered, &size);
    double spoilt_s = measured(frames, 1, &refused, &size);
    printf("SET of %ld lights, %lu bytes: %.0f a second done and answered (%lu), "
           "%.0f a second with a wrong CRC dropped (%lu), %.1f ns a byte\n",
           (long)LS_LIGHTS, (unsigned long)size, (double)frames / whole_s, answered - 1,
           (double)frames / spoilt_s, refused - 1, 1e9 * spoilt_s / (double)frames / (double)size);
    return 0;
}
