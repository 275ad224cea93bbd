/* An LED device of the acknowledged protocol (docs/led_wire.md): bytes in, lamps and bytes out.

   It takes no memory but `ls_device`, waits for nothing, and knows no board: what it needs of one
   are the functions of `ls_hardware`. All its functions are called from one place, the main loop;
   none from an interrupt. */

#ifndef LIGHTSTAGE_DEVICE_H
#define LIGHTSTAGE_DEVICE_H

#include <stdbool.h>
#include <stdint.h>

#include "limits.h"
#include "packet.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct {
    /* Let LS_LIGHTS lamps shine with these levels (0 off, 65535 full), and return when they do.
       The watchdog stands still meanwhile; what comes on the line has to wait. */
    void (*write_lamps)(void *context, const uint16_t *levels);
    /* Optional: the level at which a lamp shines, for a board that can tell; `written` is what
       write_lamps was given. Null: LIT tells what was written. */
    uint16_t (*lamp_level)(void *context, uint16_t light, uint16_t written);
    /* Send one byte. When the line takes no more, drop it: never wait for long. */
    void (*write_byte)(void *context, uint8_t byte);
    /* Milliseconds since any begin. They may start again at 0 after 2^32 - 1. */
    uint32_t (*milliseconds)(void *context);
    void *context; /* given to each of these */
} ls_hardware;

/* HELLO's text, and the fields behind it. */
#define LS_TEXT_OF(value) #value
#define LS_TEXT(value) LS_TEXT_OF(value)
#if LS_PULSE_HZ > 0
#define LS_PULSE_FIELD "\0" "pulse_hz=" LS_TEXT(LS_PULSE_HZ)
#else
#define LS_PULSE_FIELD ""
#endif
#define LS_HELLO LS_FIRMWARE "\0" "watchdog_ms=" LS_TEXT(LS_WATCHDOG_MS) LS_PULSE_FIELD
/* The longest of the replies: HELLO with boot id and lamp count, or LIT, or REFUSED's reason. */
#define LS_HELLO_BYTES (LS_HEADER + 6 + sizeof(LS_HELLO) - 1)
#define LS_REPLY_BYTES (LS_HELLO_BYTES > 48 ? LS_HELLO_BYTES : 48)

/* Nobody but device.c looks inside. */
typedef struct {
    ls_hardware hardware;
    ls_reader reader;
    uint32_t boot_id;
    uint32_t heard_ms;      /* when the last whole packet had come, and its lamps had settled */
    bool lit;               /* some light is on */
    bool asked;             /* a packet was dealt with since the reset */
    bool told_lit;          /* and answered with LIT, which is made anew for a repetition */
    uint16_t sequence;      /* its number */
    uint8_t reply_length;   /* its other answer, */
    uint8_t reply[LS_REPLY_BYTES]; /* for a repetition */
    uint16_t levels[LS_LIGHTS];
} ls_device;

/* After a reset: all lamps off, and HELLO, unasked. Each reset must have another `boot_id`. */
void ls_begin(ls_device *device, const ls_hardware *hardware, uint32_t boot_id);

/* Take one byte of the line: whole packets are done and answered, all else is dropped in silence.
   Looks at the clock as ls_tick does, so that a line full of noise keeps no light on. */
void ls_take(ls_device *device, uint8_t byte);

/* Look at the clock: all lamps off where nobody has spoken for LS_WATCHDOG_MS. To be called every
   few milliseconds at least. */
void ls_tick(ls_device *device);

#ifdef __cplusplus
}
#endif

#endif
