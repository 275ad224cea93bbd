#include "second_hand.h"

#include <string.h>

uint16_t slow_crc(const uint8_t *bytes, size_t count) {
    uint32_t crc = 0xFFFF;
    for (size_t place = 0; place < count; place++) {
        crc ^= (uint32_t)bytes[place] << 8;
        for (int bit = 0; bit < 8; bit++) {
            crc = crc & 0x8000 ? crc << 1 ^ 0x1021 : crc << 1;
        }
        crc &= 0xFFFF;
    }
    return (uint16_t)crc;
}

size_t taken_apart(const uint8_t *frame, size_t count, uint8_t *packet) {
    size_t length = 0;
    size_t place = 0;
    while (place < count) {
        size_t code = frame[place++];
        if (place + code - 1 > count) {
            return 0;
        }
        memcpy(packet + length, frame + place, code - 1);
        length += code - 1;
        place += code - 1;
        if (code < 255 && place < count) {
            packet[length++] = 0;
        }
    }
    if (length < 6 || packet[0] != 1) {
        return 0;
    }
    uint16_t crc = slow_crc(packet, length - 2);
    return packet[length - 2] == (crc & 0xFF) && packet[length - 1] == crc >> 8 ? length : 0;
}

size_t put_together(uint8_t *packet, size_t length, uint8_t *frame) {
    uint16_t crc = slow_crc(packet, length);
    packet[length++] = (uint8_t)(crc & 0xFF);
    packet[length++] = (uint8_t)(crc >> 8);
    size_t count = 1;
    size_t code_at = 0;
    for (size_t place = 0; place < length; place++) {
        if (packet[place] != 0) {
            frame[count++] = packet[place];
        }
        if (packet[place] == 0 || (count - code_at == 255 && place + 1 < length)) {
            frame[code_at] = (uint8_t)(count - code_at);
            code_at = count++;
        }
    }
    frame[code_at] = (uint8_t)(count - code_at);
    frame[count++] = 0;
    return count;
}
