/* Damaged packets by the hundred thousand, held against a second hand: fuzz COUNT SEED.

   Lamps may change only by a whole SET of the right length, to exactly its levels, by a
   whole DARK, or to darkness after a silence. Exits 1 with the frame where they did otherwise. */

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "../lightstage_leds/src/device.h"
#include "second_hand.h"

#define LONGEST (2 * LS_LIGHTS + 64)

static uint64_t random_state;

static uint32_t drawn(uint32_t below) {
    /* xorshift64*: Marsaglia, Xorshift RNGs, 2003; Vigna, 2016. */
    random_state ^= random_state >> 12;
    random_state ^= random_state << 25;
    random_state ^= random_state >> 27;
    return (uint32_t)((random_state * 0x2545F4914F6CDD1DU) >> 32) % below;
}

static uint16_t lamps[LS_LIGHTS];
static uint32_t clock_ms;
static unsigned long replies;

static void write_lamps(void *context, const uint16_t *levels) {
    (void)context;
    memcpy(lamps, levels, sizeof lamps);
}

static void write_byte(void *context, uint8_t byte) {
    (void)context;
    replies += byte == 0;
}

static uint32_t milliseconds(void *context) {
    (void)context;
    return clock_ms;
}

/* A packet without its CRC: what a host says, now and then too short, too long or unknown. */
static size_t packet_for(uint16_t sequence, uint8_t *packet) {
    static const uint8_t KINDS[] = {0x10, 0x10, 0x10, 0x10, 0x11, 0x12, 0x01, 0x20, 0x33};
    uint8_t kind = KINDS[drawn(sizeof KINDS)];
    size_t length = 4;
    packet[0] = drawn(50) == 0 ? 2 : 1;
    packet[1] = kind;
    packet[2] = (uint8_t)(sequence & 0xFF);
    packet[3] = (uint8_t)(sequence >> 8);
    if (kind == 0x10) {
        uint32_t told = drawn(20) == 0 ? drawn(65536) : LS_LIGHTS;
        size_t lights = drawn(20) == 0 ? drawn(LS_LIGHTS + 8) : LS_LIGHTS;
        packet[length++] = (uint8_t)(told & 0xFF);
        packet[length++] = (uint8_t)(told >> 8);
        int dim = drawn(3) == 0;
        for (size_t byte = 0; byte < 2 * lights; byte++) {
            packet[length++] = dim && drawn(2) ? 0 : (uint8_t)drawn(256);
        }
    } else if (drawn(20) == 0) {
        packet[length++] = (uint8_t)drawn(256);
    }
    return length;
}

static size_t noise(uint8_t *frame) {
    size_t count = drawn(40);
    for (size_t place = 0; place < count; place++) {
        frame[place] = (uint8_t)drawn(256);
    }
    return count;
}

/* One change to a frame; it never grows by more than 8 bytes. */
static size_t damaged(uint8_t *frame, size_t count) {
    size_t place = count == 0 ? 0 : drawn((uint32_t)count);
    size_t more = 1 + drawn(8);
    switch (drawn(6)) {
    case 0:
        frame[place] ^= (uint8_t)(1U << drawn(8));
        return count == 0 ? 1 : count;
    case 1:
        frame[place] = (uint8_t)drawn(256);
        return count == 0 ? 1 : count;
    case 2: /* bytes come twice */
        more = more > count - place ? count - place : more;
        memmove(frame + place + more, frame + place, count - place);
        return count + more;
    case 3: /* bytes are lost */
        more = more > count - place ? count - place : more;
        memmove(frame + place, frame + place + more, count - place - more);
        return count - more;
    case 4:
        return place; /* the end is lost */
    default:
        memmove(frame + place + 1, frame + place, count - place);
        frame[place] = drawn(4) == 0 ? 0 : (uint8_t)drawn(256);
        return count + 1;
    }
}

static int all_dark(void) {
    for (size_t light = 0; light < LS_LIGHTS; light++) {
        if (lamps[light] != 0) {
            return 0;
        }
    }
    return 1;
}

static int shows(const uint8_t *levels) {
    for (size_t light = 0; light < LS_LIGHTS; light++) {
        if (lamps[light] != (levels[2 * light] | levels[2 * light + 1] << 8)) {
            return 0;
        }
    }
    return 1;
}

static int broken(const char *what, unsigned long input, const uint8_t *frame, size_t count) {
    printf("input %lu: %s:", input, what);
    for (size_t place = 0; place < count; place++) {
        printf(" %02x", (unsigned)frame[place]);
    }
    putchar('\n');
    return 1;
}

int main(int argc, char **argv) {
    static ls_device device;
    static uint8_t stream[LONGEST + 64];
    static uint8_t packet[LONGEST + 64];
    ls_hardware hardware = {write_lamps, NULL, write_byte, milliseconds, NULL};
    unsigned long inputs = argc > 1 ? strtoul(argv[1], NULL, 10) : 100000;
    random_state = argc > 2 ? strtoul(argv[2], NULL, 10) + 1 : 1;
    unsigned long damages = 0;
    unsigned long wholes = 0;
    unsigned long changes = 0;
    unsigned long silences = 0;
    uint16_t sequence = 0;
    clock_ms = 0xFFFF0000U; /* it begins again soon */
    uint32_t heard_ms = clock_ms;
    ls_begin(&device, &hardware, 1);
    for (unsigned long input = 0; input < inputs; input++) {
        uint16_t before[LS_LIGHTS];
        memcpy(before, lamps, sizeof lamps);
        clock_ms += drawn(30) == 0 ? drawn(3 * LS_WATCHDOG_MS) : drawn(20);
        ls_tick(&device);
        if (clock_ms - heard_ms >= LS_WATCHDOG_MS) {
            if (!all_dark()) {
                return broken("a light is on after a silence", input, NULL, 0);
            }
            silences += memcmp(before, lamps, sizeof lamps) != 0;
        } else if (memcmp(before, lamps, sizeof lamps) != 0) {
            return broken("lamps changed before their time", input, NULL, 0);
        }
        /* Mostly the next number; now and then the same, or any. */
        sequence = (uint16_t)(drawn(20) == 0 ? drawn(65536) : sequence + (drawn(8) > 0 ? 1U : 0U));
        size_t count = drawn(10) == 0
                           ? noise(stream)
                           : put_together(packet, packet_for(sequence, packet), stream) - 1;
        uint32_t times = drawn(2) ? 0 : 1 + drawn(4);
        damages += times > 0;
        while (times-- > 0) {
            count = damaged(stream, count);
        }
        stream[count++] = 0;
        /* A damage can put a zero in: the pieces are frames. */
        for (size_t begin = 0, end = 0; end < count; end++) {
            memcpy(before, lamps, sizeof lamps);
            ls_take(&device, stream[end]);
            int changed = memcmp(before, lamps, sizeof lamps) != 0;
            if (stream[end] != 0) {
                if (changed) {
                    return broken("lamps changed inside a frame", input, stream, count);
                }
                continue;
            }
            size_t length = taken_apart(stream + begin, end - begin, packet);
            int set = length == 8 + 2 * LS_LIGHTS && packet[1] == 0x10 &&
                      (packet[4] | packet[5] << 8) == LS_LIGHTS;
            int dark = length == 6 && packet[1] == 0x11;
            if (changed && !(set && shows(packet + 6)) && !(dark && all_dark())) {
                return broken("lamps changed by what is no command", input, stream + begin,
                              end - begin);
            }
            if (length > 0) {
                heard_ms = clock_ms;
                wholes++;
            }
            changes += (unsigned long)changed;
            begin = end + 1;
        }
    }
    printf("%lu inputs, %lu damaged; %lu whole packets, %lu replies, %lu changes of the lamps, "
           "%lu silences\n", inputs, damages, wholes, replies, changes, silences);
    return 0;
}
