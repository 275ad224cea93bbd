/* The numbers of one stage: change them here, or with -D where a compiler is called by hand. */

#ifndef LIGHTSTAGE_LIMITS_H
#define LIGHTSTAGE_LIMITS_H

/* How many lights there are. */
#ifndef LS_LIGHTS
#define LS_LIGHTS 168
#endif

/* Dark after so many milliseconds without a whole packet. Plain digits: HELLO tells them as text.
   What is left to a second is for the main loop and for the lamps. */
#ifndef LS_WATCHDOG_MS
#define LS_WATCHDOG_MS 900
#endif

/* So many bytes without a zero are noise: what comes until the next zero is passed over. It costs
   no memory. As large as this, a SET of any lamp count is still answered: "wrong lamp count". */
#ifndef LS_MAX_FRAME
#define LS_MAX_FRAME 262144
#endif

/* How often a second the lamps are switched to dim them, in plain digits; 0: it is not told. */
#ifndef LS_PULSE_HZ
#define LS_PULSE_HZ 0
#endif

/* Who HELLO says is there. */
#ifndef LS_FIRMWARE
#define LS_FIRMWARE "lightstage-firmware 1"
#endif

#if LS_LIGHTS < 1 || LS_LIGHTS > 65535
#error "LS_LIGHTS must be 1 to 65535: the wire counts lights with 16 bits"
#endif
#if LS_WATCHDOG_MS < 100 || LS_WATCHDOG_MS > 1000
#error "LS_WATCHDOG_MS must be 100 to 1000: dark within a second of silence"
#endif
#if LS_PULSE_HZ < 0 || LS_PULSE_HZ > 10000000
#error "LS_PULSE_HZ must be 0 (not told) to 10000000"
#endif
/* A SET has 8 bytes and 2 a light; COBS adds one, and one more for every 254. */
#if LS_MAX_FRAME < 8 + 2 * LS_LIGHTS + (8 + 2 * LS_LIGHTS) / 254 + 1 || LS_MAX_FRAME > 16777216
#error "LS_MAX_FRAME must hold a SET of LS_LIGHTS lights, and be at most 16777216"
#endif

/* A condition on what only the compiler knows; C99 has no static assertion of its own. */
#define LS_ASSERT(name, condition) typedef char ls_assert_##name[(condition) ? 1 : -1]

#endif
