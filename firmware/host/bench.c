/* The firmware on a test bench: the clock, the line and the lamps are records on stdin and stdout.

   A record is one letter, a number (u32, little endian), and for some letters so many bytes.

   in:  b N bytes   come on the line
        c MS        the clock shows MS milliseconds, and the main loop looks at it
        s MS        from now on the lamps take MS milliseconds to settle
        z ID        reset, with this boot id
   out: r N bytes   a packet was sent
        l N bytes   the lamps were written (levels, u16 little endian)
        q 0         what do the lamps say? as many bytes as an l has must follow on stdin;
                    only where the program was called with `--ask`
        d 0         the record was dealt with */

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "../lightstage_leds/src/device.h"

static uint32_t clock_ms;
static uint32_t settle_ms;
static uint8_t said[2 * LS_LIGHTS];
static uint8_t packet[LS_SHORT + 8];
static size_t packet_length;

static void take(void *data, size_t size) {
    if (size > 0 && fread(data, 1, size, stdin) != size) {
        exit(0); /* whoever tested has gone */
    }
}

static void tell(char letter, const void *data, uint32_t size) {
    putchar(letter);
    for (unsigned shift = 0; shift < 32; shift += 8) {
        putchar((int)(size >> shift & 0xFF));
    }
    fwrite(data, 1, size, stdout);
}

static void write_lamps(void *context, const uint16_t *levels) {
    (void)context;
    uint8_t bytes[2 * LS_LIGHTS];
    for (size_t light = 0; light < LS_LIGHTS; light++) {
        bytes[2 * light] = (uint8_t)(levels[light] & 0xFF);
        bytes[2 * light + 1] = (uint8_t)(levels[light] >> 8);
    }
    clock_ms += settle_ms;
    tell('l', bytes, sizeof bytes);
}

static uint16_t lamp_level(void *context, uint16_t light, uint16_t written) {
    (void)context;
    (void)written;
    if (light == 0) {
        tell('q', "", 0);
        fflush(stdout);
        take(said, sizeof said);
    }
    return (uint16_t)(said[2 * light] | said[2 * light + 1] << 8);
}

static void write_byte(void *context, uint8_t byte) {
    (void)context;
    packet[packet_length++] = byte;
    if (byte == 0) {
        tell('r', packet, (uint32_t)packet_length);
        packet_length = 0;
    }
}

static uint32_t milliseconds(void *context) {
    (void)context;
    return clock_ms;
}

int main(int count, char **words) {
    static ls_device device;
    ls_hardware hardware = {write_lamps, NULL, write_byte, milliseconds, NULL};
    if (count > 1 && strcmp(words[1], "--ask") == 0) {
        hardware.lamp_level = lamp_level;
    }
    for (;;) {
        uint8_t head[5];
        take(head, sizeof head);
        uint32_t number = head[1] | (uint32_t)head[2] << 8 | (uint32_t)head[3] << 16 |
                          (uint32_t)head[4] << 24;
        switch (head[0]) {
        case 'b':
            while (number-- > 0) {
                uint8_t byte;
                take(&byte, 1);
                ls_take(&device, byte);
            }
            break;
        case 'c':
            clock_ms = number;
            ls_tick(&device);
            break;
        case 's':
            settle_ms = number;
            break;
        case 'z':
            ls_begin(&device, &hardware, number);
            break;
        default:
            fprintf(stderr, "an unknown record, %d\n", head[0]);
            return 2;
        }
        tell('d', "", 0);
        fflush(stdout);
    }
}
