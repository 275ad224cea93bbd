/* What one byte costs at most, counted: steps FRAMES SEED.

   The compiler puts a call at the begin of each basic block of the firmware
   (-fsanitize-coverage=trace-pc). Prints the most blocks that a byte cost which ended no whole
   packet, and the most that the last byte of a whole packet cost. */

#include <stdio.h>
#include <stdlib.h>

#include "../lightstage_leds/src/device.h"
#include "second_hand.h"

static unsigned long blocks;
static unsigned long most_of_others;
static unsigned long most_of_whole;
static unsigned long replies;
static uint32_t random_state;

void __sanitizer_cov_trace_pc(void);

void __sanitizer_cov_trace_pc(void) {
    blocks++;
}

static uint32_t drawn(uint32_t below) {
    /* Knuth's and Lewis's, of Numerical Recipes; its high bits. */
    random_state = random_state * 1664525U + 1013904223U;
    return (random_state >> 8) % below;
}

static void write_lamps(void *context, const uint16_t *levels) {
    (void)context;
    (void)levels;
}

static void write_byte(void *context, uint8_t byte) {
    (void)context;
    replies += byte == 0;
}

static uint32_t milliseconds(void *context) {
    (void)context;
    return 0;
}

static void take(ls_device *device, uint8_t byte) {
    unsigned long before = replies;
    blocks = 0;
    ls_take(device, byte);
    unsigned long *most = replies > before ? &most_of_whole : &most_of_others;
    *most = blocks > *most ? blocks : *most;
}

int main(int argc, char **argv) {
    static const uint8_t KINDS[] = {0x01, 0x10, 0x11, 0x12, 0x33};
    static ls_device device;
    static uint8_t packet[LS_BODY + 2];
    static uint8_t frame[2 * LS_BODY + 8];
    ls_hardware hardware = {write_lamps, NULL, write_byte, milliseconds, NULL};
    unsigned long frames = argc > 1 ? strtoul(argv[1], NULL, 10) : 1000;
    random_state = argc > 2 ? (uint32_t)strtoul(argv[2], NULL, 10) : 1;
    ls_begin(&device, &hardware, 1);
    for (unsigned long number = 0; number < frames; number++) {
        /* Noise of short blocks or long ones, some of it longer than any packet that is kept. */
        uint32_t noise = drawn(8) == 0 ? 4 * LS_BODY : drawn(300);
        uint32_t longest_block = drawn(2) == 0 ? 255 : 3;
        while (noise-- > 0) {
            take(&device, (uint8_t)(1 + drawn(longest_block)));
        }
        take(&device, 0);
        packet[0] = LS_VERSION;
        packet[1] = KINDS[drawn(sizeof KINDS)];
        packet[2] = (uint8_t)(number & 0xFF);
        packet[3] = (uint8_t)(number >> 8 & 0xFF);
        packet[4] = LS_LIGHTS & 0xFF;
        packet[5] = LS_LIGHTS >> 8;
        for (size_t place = 6; place < LS_BODY; place++) {
            packet[place] = drawn(2) == 0 ? 0 : (uint8_t)drawn(256);
        }
        size_t count = put_together(packet, packet[1] == 0x10 ? LS_BODY : LS_HEADER, frame);
        for (size_t place = 0; place < count; place++) {
            take(&device, frame[place]);
        }
    }
    printf("%lu %lu\n", most_of_others, most_of_whole);
    return 0;
}
