/* Packets out of bytes, and bytes out of packets (docs/led_wire.md): COBS, version, CRC. */

#ifndef LIGHTSTAGE_PACKET_H
#define LIGHTSTAGE_PACKET_H

#include <stdbool.h>
#include <stdint.h>

#include "limits.h"

#ifdef __cplusplus
extern "C" {
#endif

#define LS_VERSION 1
#define LS_HEADER 4 /* version, type, sequence number */
/* Of a packet so much is kept: its header and a SET's payload. */
#define LS_BODY (LS_HEADER + 2 + 2UL * LS_LIGHTS)

/* Takes a packet apart byte by byte; all zeros at the begin. What one byte costs does not depend on what came before. */
typedef struct {
    uint32_t taken;      /* bytes since the last zero; never more than LS_MAX_FRAME + 1 */
    uint32_t length;     /* bytes of the packet so far, without the newest two: header, payload */
    uint16_t crc;        /* of those */
    uint8_t newest[2];   /* which are the CRC if nothing follows */
    uint8_t newest_count;
    uint8_t block_left;  /* bytes that the COBS block still has */
    bool zero_due;       /* the next block stands behind a zero */
    uint8_t body[LS_BODY];
} ls_reader;

/* Take one byte. Returns whether it was the last of a whole packet: `length` and `body` hold it
   until the next byte is taken. Of a longer packet the body has the first LS_BODY bytes. */
bool ls_reader_take(ls_reader *reader, uint8_t byte);

/* CRC-16/IBM-3740 of one byte more; it begins with 0xFFFF. */
uint16_t ls_crc(uint16_t crc, uint8_t byte);

/* Write a body of at most LS_SHORT bytes as a packet: its CRC behind it, COBS, the closing zero. */
#define LS_SHORT 251
void ls_write_packet(const uint8_t *body, uint8_t length, void (*write_byte)(void *, uint8_t),
                     void *context);

#ifdef __cplusplus
}
#endif

#endif
