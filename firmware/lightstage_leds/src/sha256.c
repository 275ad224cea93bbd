#include "sha256.h"

/* First 32 bits of the fractional parts of the cube roots of the first 64 primes. */
static const uint32_t ROUND[64] = {
    0x428a2f98, 0x71374491, 0xb5c0fbcf, 0xe9b5dba5, 0x3956c25b, 0x59f111f1, 0x923f82a4, 0xab1c5ed5,
    0xd807aa98, 0x12835b01, 0x243185be, 0x550c7dc3, 0x72be5d74, 0x80deb1fe, 0x9bdc06a7, 0xc19bf174,
    0xe49b69c1, 0xefbe4786, 0x0fc19dc6, 0x240ca1cc, 0x2de92c6f, 0x4a7484aa, 0x5cb0a9dc, 0x76f988da,
    0x983e5152, 0xa831c66d, 0xb00327c8, 0xbf597fc7, 0xc6e00bf3, 0xd5a79147, 0x06ca6351, 0x14292967,
    0x27b70a85, 0x2e1b2138, 0x4d2c6dfc, 0x53380d13, 0x650a7354, 0x766a0abb, 0x81c2c92e, 0x92722c85,
    0xa2bfe8a1, 0xa81a664b, 0xc24b8b70, 0xc76c51a3, 0xd192e819, 0xd6990624, 0xf40e3585, 0x106aa070,
    0x19a4c116, 0x1e376c08, 0x2748774c, 0x34b0bcb5, 0x391c0cb3, 0x4ed8aa4a, 0x5b9cca4f, 0x682e6ff3,
    0x748f82ee, 0x78a5636f, 0x84c87814, 0x8cc70208, 0x90befffa, 0xa4506ceb, 0xbef9a3f7, 0xc67178f2,
};

/* A word turned to the right. Processors of 8 bits shift one bit at a time, but move whole bytes:
   so they take half of the time. */
static uint32_t turned(uint32_t word, uint8_t bits) {
    if (bits & 16) {
        word = (word >> 16) | (word << 16);
    }
    if (bits & 8) {
        word = (word >> 8) | (word << 24);
    }
    for (uint8_t left = bits & 7; left > 0; left--) {
        word = (word >> 1) | (word << 31);
    }
    return word;
}

static void add_block(ls_sha256 *sum) {
    uint32_t *w = sum->words;
    uint32_t s[8];
    for (unsigned i = 0; i < 8; i++) {
        s[i] = sum->state[i];
    }
    for (unsigned i = 0; i < 64; i++) {
        if (i >= 16) {
            /* Of the 64 words of the schedule the newest 16 are kept, in a ring. */
            uint32_t w15 = w[(i + 1) & 15];
            uint32_t w2 = w[(i + 14) & 15];
            uint32_t s0 = turned(w15, 7) ^ turned(w15, 18) ^ (w15 >> 3);
            uint32_t s1 = turned(w2, 17) ^ turned(w2, 19) ^ (w2 >> 10);
            w[i & 15] += s0 + w[(i + 9) & 15] + s1;
        }
        uint32_t choice = (s[4] & s[5]) ^ (~s[4] & s[6]);
        uint32_t majority = (s[0] & s[1]) ^ (s[0] & s[2]) ^ (s[1] & s[2]);
        uint32_t big1 = turned(s[4], 6) ^ turned(s[4], 11) ^ turned(s[4], 25);
        uint32_t big0 = turned(s[0], 2) ^ turned(s[0], 13) ^ turned(s[0], 22);
        uint32_t first = s[7] + big1 + choice + ROUND[i] + w[i & 15];
        for (unsigned k = 7; k > 0; k--) {
            s[k] = s[k - 1];
        }
        s[4] += first;
        s[0] = first + big0 + majority;
    }
    for (unsigned i = 0; i < 8; i++) {
        sum->state[i] += s[i];
    }
}

void ls_sha256_begin(ls_sha256 *sum) {
    /* First 32 bits of the fractional parts of the square roots of the first 8 primes. */
    static const uint32_t START[8] = {
        0x6a09e667, 0xbb67ae85, 0x3c6ef372, 0xa54ff53a,
        0x510e527f, 0x9b05688c, 0x1f83d9ab, 0x5be0cd19,
    };
    for (unsigned i = 0; i < 8; i++) {
        sum->state[i] = START[i];
    }
    for (unsigned i = 0; i < 16; i++) {
        sum->words[i] = 0;
    }
    sum->length = 0;
}

void ls_sha256_take(ls_sha256 *sum, uint8_t byte) {
    uint32_t *word = &sum->words[(sum->length >> 2) & 15];
    /* Four bytes, the first one highest, push out what stood there. */
    *word = (*word << 8) | byte;
    sum->length++;
    if ((sum->length & 63) == 0) {
        add_block(sum);
    }
}

void ls_sha256_end(ls_sha256 *sum, uint8_t hash[LS_SHA256]) {
    uint32_t bits = sum->length << 3;
    ls_sha256_take(sum, 0x80);
    while ((sum->length & 63) != 56) {
        ls_sha256_take(sum, 0);
    }
    /* The count of bits has 64; the higher 32 are zero. */
    for (unsigned i = 0; i < 4; i++) {
        ls_sha256_take(sum, 0);
    }
    for (unsigned shift = 32; shift > 0; shift -= 8) {
        ls_sha256_take(sum, (uint8_t)(bits >> (shift - 8)));
    }
    for (unsigned i = 0; i < LS_SHA256; i++) {
        hash[i] = (uint8_t)(sum->state[i >> 2] >> (24 - 8 * (i & 3)));
    }
}
