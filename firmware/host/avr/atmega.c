/* The sketch's own program for an ATmega, in simavr, behind a pseudo-terminal: atmega PROGRAM MCU.

   Prints the terminal's name, then a line for each change of the pin BLANK: the ATmega's
   milliseconds, and what a chain of TLC5947 shines with, as hexadecimal numbers of four digits. On
   stderr: how long each reply took. Runs no faster than the ATmega would, and ends when its
   standard input does. */

#define _XOPEN_SOURCE 600

#include <fcntl.h>
#include <poll.h>
#include <simavr/avr_ioport.h>
#include <simavr/avr_spi.h>
#include <simavr/avr_uart.h>
#include <simavr/sim_avr.h>
#include <simavr/sim_elf.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#include "../../lightstage_leds/src/limits.h"

#define CLOCK_HZ 16000000
#define CYCLES_A_MS (CLOCK_HZ / 1000)
/* Of 250,000 baud: ten bits. */
#define CYCLES_A_BYTE 640
#define CHANNELS ((LS_LIGHTS + 23) / 24 * 24)
#define CHAIN (CHANNELS * 3 / 2)

static avr_t *avr;
static int line;
static uint8_t shifted[CHAIN];
static uint8_t latched[CHAIN];
static avr_cycle_count_t last_in;
static avr_cycle_count_t first_out;

static void say_nothing(avr_t *which, const int level, const char *format, va_list words) {
    (void)which;
    (void)level;
    (void)format;
    (void)words;
}

static void on_reply(struct avr_irq_t *irq, uint32_t value, void *param) {
    (void)irq;
    (void)param;
    uint8_t byte = (uint8_t)value;
    first_out = first_out == 0 ? avr->cycle : first_out;
    if (byte == 0) {
        fprintf(stderr, "reply after %.2f ms\n", (double)(first_out - last_in) / CYCLES_A_MS);
        first_out = 0;
    }
    if (write(line, &byte, 1) < 0) {
        return; /* nobody reads */
    }
}

static void on_shift(struct avr_irq_t *irq, uint32_t value, void *param) {
    (void)irq;
    (void)param;
    memmove(shifted, shifted + 1, CHAIN - 1);
    shifted[CHAIN - 1] = (uint8_t)value;
}

static void on_latch(struct avr_irq_t *irq, uint32_t value, void *param) {
    (void)irq;
    (void)param;
    if (value != 0) {
        memcpy(latched, shifted, CHAIN);
    }
}

static void on_blank(struct avr_irq_t *irq, uint32_t value, void *param) {
    (void)irq;
    (void)param;
    printf("%lu ", (unsigned long)(avr->cycle / CYCLES_A_MS));
    for (unsigned channel = 0; channel < CHANNELS; channel++) {
        /* Two channels are three bytes; what was shifted in first has gone farthest. */
        const uint8_t *pair = latched + (CHANNELS - 1 - channel) / 2 * 3;
        unsigned odd = (unsigned)pair[0] << 4 | pair[1] >> 4;
        unsigned even = (pair[1] & 15U) << 8 | pair[2];
        printf("%04x", value != 0 ? 0 : channel % 2 ? odd : even);
    }
    putchar('\n');
    fflush(stdout);
}

static void listen(uint32_t control, int index, avr_irq_notify_t call) {
    avr_irq_register_notify(avr_io_getirq(avr, control, index), call, NULL);
}

/* The device's end of a new terminal that passes all bytes as they are. */
static int new_line(void) {
    int end = posix_openpt(O_RDWR | O_NOCTTY | O_NONBLOCK);
    struct termios raw;
    if (end < 0 || grantpt(end) != 0 || unlockpt(end) != 0 || tcgetattr(end, &raw) != 0) {
        perror("pseudo-terminal");
        exit(1);
    }
    raw.c_iflag = 0;
    raw.c_oflag = 0;
    raw.c_lflag = 0;
    tcsetattr(end, TCSANOW, &raw);
    int host = open(ptsname(end), O_RDWR | O_NOCTTY);
    tcsetattr(host, TCSANOW, &raw);
    close(host);
    printf("%s\n", ptsname(end));
    fflush(stdout);
    return end;
}

static double now_s(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

int main(int count, char **words) {
    static elf_firmware_t program;
    if (count != 3) {
        fprintf(stderr, "atmega PROGRAM MCU\n");
        return 2;
    }
    avr_global_logger_set(say_nothing);
    avr = avr_make_mcu_by_name(words[2]);
    if (avr == NULL || elf_read_firmware(words[1], &program) != 0) {
        fprintf(stderr, "no such processor, or no such program\n");
        return 2;
    }
    avr_init(avr);
    program.frequency = CLOCK_HZ;
    avr_load_firmware(avr, &program);
    line = new_line();
    uint32_t flags = 0;
    avr_ioctl(avr, AVR_IOCTL_UART_GET_FLAGS('0'), &flags);
    flags &= ~(uint32_t)(AVR_UART_FLAG_STDIO | AVR_UART_FLAG_POLL_SLEEP);
    avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0'), &flags);
    int mega = strcmp(words[2], "atmega2560") == 0;
    listen(AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUTPUT, on_reply);
    listen(AVR_IOCTL_SPI_GETIRQ(0), SPI_IRQ_OUTPUT, on_shift);
    /* Pins 9 and 10 of the boards. */
    listen(mega ? AVR_IOCTL_IOPORT_GETIRQ('H') : AVR_IOCTL_IOPORT_GETIRQ('B'), mega ? 6 : 1,
           on_blank);
    listen(AVR_IOCTL_IOPORT_GETIRQ('B'), mega ? 4 : 2, on_latch);
    avr_irq_t *input = avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_INPUT);
    uint8_t bytes[512];
    uint8_t key;
    ssize_t got = 0;
    ssize_t place = 0;
    avr_cycle_count_t next_look = 0;
    double begun_s = now_s();
    for (;;) {
        int state = avr_run(avr);
        if (state == cpu_Done || state == cpu_Crashed) {
            fprintf(stderr, "the program ended\n");
            return 1;
        }
        if (place < got && avr->cycle >= last_in + CYCLES_A_BYTE) {
            /* The line does not wait for the program. */
            last_in = avr->cycle;
            avr_raise_irq(input, bytes[place++]);
        }
        if (avr->cycle < next_look) {
            continue;
        }
        next_look = avr->cycle + CYCLES_A_MS;
        if (place >= got) {
            got = read(line, bytes, sizeof bytes);
            place = 0;
        }
        struct pollfd end = {.fd = STDIN_FILENO, .events = POLLIN};
        if (poll(&end, 1, 0) > 0 && read(STDIN_FILENO, &key, 1) <= 0) {
            return 0;
        }
        double ahead_s = (double)avr->cycle / CLOCK_HZ - (now_s() - begun_s);
        if (ahead_s > 0) {
            poll(NULL, 0, (int)(1e3 * ahead_s) + 1);
        }
    }
}
