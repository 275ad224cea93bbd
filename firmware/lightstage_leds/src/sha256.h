/* SHA-256 (FIPS 180-4), byte by byte. */

#ifndef LIGHTSTAGE_SHA256_H
#define LIGHTSTAGE_SHA256_H

#include <stdint.h>

#define LS_SHA256 32

typedef struct {
    uint32_t state[8];
    uint32_t length;    /* bytes so far; at most 2^29 - 1 */
    uint32_t words[16]; /* of the block that is being filled */
} ls_sha256;

void ls_sha256_begin(ls_sha256 *sum);
void ls_sha256_take(ls_sha256 *sum, uint8_t byte);
/* The hash of all that was taken; the sum is used up. */
void ls_sha256_end(ls_sha256 *sum, uint8_t hash[LS_SHA256]);

#endif
