/* Packets taken apart and put together whole, as docs/led_wire.md says it. The firmware shares no
   line with this: what both hold for a packet is one. */

#ifndef LIGHTSTAGE_SECOND_HAND_H
#define LIGHTSTAGE_SECOND_HAND_H

#include <stddef.h>
#include <stdint.h>

/* CRC-16/IBM-3740, bit by bit. */
uint16_t slow_crc(const uint8_t *bytes, size_t count);

/* The packet in a frame without zeros, with its CRC; returns its length, 0 where it is none. */
size_t taken_apart(const uint8_t *frame, size_t count, uint8_t *packet);

/* The frame of a packet, to which its CRC is put, with the closing zero; returns its length.
   `packet` needs room for 2 bytes more, `frame` for length + length / 254 + 5. */
size_t put_together(uint8_t *packet, size_t length, uint8_t *frame);

#endif
