#include "packet.h"

/* One COBS block, with no case for a full one, holds body and CRC. */
LS_ASSERT(short_packets_are_one_block, LS_SHORT + 2 < 254);

uint16_t ls_crc(uint16_t crc, uint8_t byte) {
    /* x^16 + x^12 + x^5 + 1, eight bits at a time: the byte that leaves, folded onto itself, comes
       back at these three places. */
    uint8_t out = (uint8_t)((crc >> 8) ^ byte);
    out = (uint8_t)(out ^ (out >> 4));
    return (uint16_t)(((unsigned)crc << 8) ^ ((unsigned)out << 12) ^ ((unsigned)out << 5) ^ out);
}

static void begin_packet(ls_reader *reader) {
    reader->taken = 0;
    reader->length = 0;
    reader->crc = 0xFFFF;
    reader->newest_count = 0;
    reader->block_left = 0;
    reader->zero_due = false;
}

/* One decoded byte. Only what has two behind it is known not to be the CRC. */
static void decoded(ls_reader *reader, uint8_t byte) {
    if (reader->newest_count < 2) {
        reader->newest[reader->newest_count++] = byte;
        return;
    }
    uint8_t settled = reader->newest[0];
    reader->newest[0] = reader->newest[1];
    reader->newest[1] = byte;
    reader->crc = ls_crc(reader->crc, settled);
    if (reader->length < LS_BODY) {
        reader->body[reader->length] = settled;
    }
    reader->length++;
}

static bool whole(const ls_reader *reader) {
    uint16_t crc = (uint16_t)(reader->newest[0] | ((unsigned)reader->newest[1] << 8));
    return reader->taken <= LS_MAX_FRAME && reader->block_left == 0 &&
           reader->length >= LS_HEADER && reader->crc == crc && reader->body[0] == LS_VERSION;
}

bool ls_reader_take(ls_reader *reader, uint8_t byte) {
    if (reader->taken == 0) {
        /* The packet before stood there for whoever asked. */
        begin_packet(reader);
    }
    if (byte == 0) {
        bool good = whole(reader);
        reader->taken = 0;
        return good;
    }
    if (reader->taken > LS_MAX_FRAME) {
        return false;
    }
    reader->taken++;
    if (reader->block_left > 0) {
        reader->block_left--;
        decoded(reader, byte);
        return false;
    }
    /* A COBS code: so many bytes follow, less one; then a zero, unless it is full or last. */
    if (reader->zero_due) {
        decoded(reader, 0);
    }
    reader->block_left = (uint8_t)(byte - 1);
    reader->zero_due = byte != 0xFF;
    return false;
}

/* The byte of body and CRC at a place. */
static uint8_t byte_at(const uint8_t *body, uint8_t length, uint16_t crc, uint8_t place) {
    if (place < length) {
        return body[place];
    }
    return (uint8_t)(place == length ? crc & 0xFF : crc >> 8);
}

void ls_write_packet(const uint8_t *body, uint8_t length, void (*write_byte)(void *, uint8_t),
                     void *context) {
    uint16_t crc = 0xFFFF;
    for (uint8_t place = 0; place < length; place++) {
        crc = ls_crc(crc, body[place]);
    }
    uint8_t end = (uint8_t)(length + 2);
    uint8_t begin = 0;
    for (;;) {
        uint8_t zero = begin;
        while (zero < end && byte_at(body, length, crc, zero) != 0) {
            zero++;
        }
        write_byte(context, (uint8_t)(zero - begin + 1));
        for (uint8_t place = begin; place < zero; place++) {
            write_byte(context, byte_at(body, length, crc, place));
        }
        if (zero == end) {
            break;
        }
        begin = (uint8_t)(zero + 1);
    }
    write_byte(context, 0);
}
