#include "device.h"

#include <string.h>

#include "sha256.h"

enum {
    ASK_HELLO = 0x01,
    HELLO = 0x02,
    SET = 0x10,
    DARK = 0x11,
    ASK_STATE = 0x12,
    LIT = 0x20,
    REFUSED = 0x2F
};
enum { UNKNOWN_TYPE = 1, WRONG_COUNT = 2, BAD_LENGTH = 3 };

/* A number so far ahead of the last one, or more, is behind it. */
#define BEHIND 0x8000

static const char HELLO_TEXT[] = LS_HELLO;

LS_ASSERT(a_reply_is_short, LS_REPLY_BYTES <= LS_SHORT);
LS_ASSERT(a_lit_fits, LS_HEADER + LS_SHA256 <= LS_REPLY_BYTES);
/* The longest reason has two numbers: "16777216 bytes for 65535 lights". */
LS_ASSERT(a_reason_fits, LS_HEADER + 1 + 31 <= LS_REPLY_BYTES);

static uint16_t u16_at(const uint8_t *bytes) {
    return (uint16_t)(bytes[0] | ((unsigned)bytes[1] << 8));
}

static uint32_t now_ms(const ls_device *device) {
    return device->hardware.milliseconds(device->hardware.context);
}

/* Replies are put together in device->reply and stay there for a repetition. */

static void put(ls_device *device, uint8_t byte) {
    device->reply[device->reply_length++] = byte;
}

static void put_text(ls_device *device, const char *text) {
    while (*text != '\0') {
        put(device, (uint8_t)*text++);
    }
}

static void put_number(ls_device *device, uint32_t number) {
    char digits[10];
    uint8_t count = 0;
    do {
        digits[count++] = (char)('0' + number % 10);
        number /= 10;
    } while (number > 0);
    while (count > 0) {
        put(device, (uint8_t)digits[--count]);
    }
}

static void put_header(ls_device *device, uint8_t kind, uint16_t sequence) {
    device->reply_length = 0;
    put(device, LS_VERSION);
    put(device, kind);
    put(device, (uint8_t)(sequence & 0xFF));
    put(device, (uint8_t)(sequence >> 8));
}

static void send(ls_device *device) {
    ls_write_packet(device->reply, device->reply_length, device->hardware.write_byte,
                    device->hardware.context);
}

static void put_hello(ls_device *device, uint16_t sequence) {
    put_header(device, HELLO, sequence);
    for (unsigned shift = 0; shift < 32; shift += 8) {
        put(device, (uint8_t)(device->boot_id >> shift));
    }
    put(device, (uint8_t)(LS_LIGHTS & 0xFF));
    put(device, (uint8_t)(LS_LIGHTS >> 8));
    for (unsigned place = 0; place < sizeof HELLO_TEXT - 1; place++) {
        put(device, (uint8_t)HELLO_TEXT[place]);
    }
}

static void put_lit(ls_device *device, uint16_t sequence) {
    ls_sha256 sum;
    const ls_hardware *hardware = &device->hardware;
    ls_sha256_begin(&sum);
    for (uint32_t light = 0; light < LS_LIGHTS; light++) {
        uint16_t level = device->levels[light];
        if (hardware->lamp_level != NULL) {
            level = hardware->lamp_level(hardware->context, (uint16_t)light, level);
        }
        ls_sha256_take(&sum, (uint8_t)(level & 0xFF));
        ls_sha256_take(&sum, (uint8_t)(level >> 8));
    }
    put_header(device, LIT, sequence);
    ls_sha256_end(&sum, device->reply + device->reply_length);
    device->reply_length = (uint8_t)(device->reply_length + LS_SHA256);
}

/* REFUSED, up to its reason. */
static void put_refused(ls_device *device, uint16_t sequence, uint8_t code) {
    put_header(device, REFUSED, sequence);
    put(device, code);
}

static void refuse_type(ls_device *device, uint16_t sequence, uint8_t kind) {
    static const char HEX[] = "0123456789abcdef";
    put_refused(device, sequence, UNKNOWN_TYPE);
    put_text(device, "type 0x");
    put(device, (uint8_t)HEX[kind >> 4]);
    put(device, (uint8_t)HEX[kind & 15]);
}

static void refuse_length(ls_device *device, uint16_t sequence, uint32_t length,
                          const char *expected) {
    put_refused(device, sequence, BAD_LENGTH);
    put_number(device, length);
    put_text(device, " bytes");
    put_text(device, expected);
}

/* Lamps are written even where nothing changes: one that lost its level gets it again. While they
   settle the host is silent, because it waits for the answer. */
static void write_lamps(ls_device *device) {
    device->hardware.write_lamps(device->hardware.context, device->levels);
    device->heard_ms = now_ms(device);
}

static void put_out(ls_device *device) {
    memset(device->levels, 0, sizeof device->levels);
    device->lit = false;
    write_lamps(device);
}

/* Returns whether the answer is LIT; else the refusal has been put together. */
static bool set(ls_device *device, uint16_t sequence, uint32_t length) {
    const uint8_t *payload = device->reader.body + LS_HEADER;
    if (length < 2) {
        refuse_length(device, sequence, length, "");
        return false;
    }
    uint16_t count = u16_at(payload);
    if (count != LS_LIGHTS) {
        put_refused(device, sequence, WRONG_COUNT);
        put_number(device, count);
        put_text(device, " of ");
        put_number(device, LS_LIGHTS);
        put_text(device, " lights");
        return false;
    }
    if (length != 2 + 2UL * LS_LIGHTS) {
        refuse_length(device, sequence, length, " for ");
        put_number(device, count);
        put_text(device, " lights");
        return false;
    }
    device->lit = false;
    for (uint32_t light = 0; light < LS_LIGHTS; light++) {
        device->levels[light] = u16_at(payload + 2 + 2 * light);
        device->lit = device->lit || device->levels[light] > 0;
    }
    write_lamps(device);
    return true;
}

/* Do what is asked; returns whether the answer is LIT, else it has been put together. */
static bool handle(ls_device *device, uint8_t kind, uint16_t sequence, uint32_t length) {
    if (kind == SET) {
        return set(device, sequence, length);
    }
    if (kind != ASK_HELLO && kind != DARK && kind != ASK_STATE) {
        refuse_type(device, sequence, kind);
        return false;
    }
    if (length > 0) {
        refuse_length(device, sequence, length, ", expected none");
        return false;
    }
    if (kind == ASK_HELLO) {
        put_hello(device, sequence);
        return false;
    }
    if (kind == DARK) {
        put_out(device);
    }
    return true;
}

static void answer(ls_device *device) {
    uint8_t kind = device->reader.body[1];
    uint16_t sequence = u16_at(device->reader.body + 2);
    bool repeated = device->asked && sequence == device->sequence;
    if (!repeated) {
        uint16_t ahead = (uint16_t)(sequence - device->sequence);
        if (device->asked && kind != ASK_HELLO && ahead >= BEHIND) {
            return;
        }
        device->asked = true;
        device->sequence = sequence;
        device->told_lit = handle(device, kind, sequence, device->reader.length - LS_HEADER);
    }
    if (device->told_lit) {
        put_lit(device, sequence);
    }
    send(device);
}

void ls_begin(ls_device *device, const ls_hardware *hardware, uint32_t boot_id) {
    memset(device, 0, sizeof *device);
    device->hardware = *hardware;
    device->boot_id = boot_id;
    put_out(device);
    put_hello(device, 0);
    send(device);
}

void ls_tick(ls_device *device) {
    /* The difference of unsigned numbers is right also where the clock began again between them. */
    if (device->lit && (uint32_t)(now_ms(device) - device->heard_ms) >= LS_WATCHDOG_MS) {
        put_out(device);
    }
}

void ls_take(ls_device *device, uint8_t byte) {
    ls_tick(device);
    if (ls_reader_take(&device->reader, byte)) {
        device->heard_ms = now_ms(device);
        answer(device);
    }
}
