/* The firmware behind a pseudo-terminal, with this computer's clock: a device without a board.

   Prints the terminal's name, then a line for each write of the lamps: milliseconds, and the levels
   as hexadecimal numbers of four digits. Ends when its standard input does. */

#define _XOPEN_SOURCE 600

#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#include "../lightstage_leds/src/device.h"

/* While nobody has the terminal open, poll does not wait. */
#define CLOSED_MS 5
#define TICK_MS 5

static int line;

static uint32_t milliseconds(void *context) {
    (void)context;
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (uint32_t)((uint64_t)now.tv_sec * 1000 + (uint64_t)now.tv_nsec / 1000000);
}

static void write_lamps(void *context, const uint16_t *levels) {
    printf("%lu ", (unsigned long)milliseconds(context));
    for (size_t light = 0; light < LS_LIGHTS; light++) {
        printf("%04x", (unsigned)levels[light]);
    }
    putchar('\n');
    fflush(stdout);
}

static void write_byte(void *context, uint8_t byte) {
    static uint8_t packet[LS_SHORT + 8];
    static size_t length;
    (void)context;
    packet[length++] = byte;
    if (byte == 0) {
        /* The line never waits. A host that does not read loses the packet, or its end. */
        if (write(line, packet, length) < 0 && errno != EAGAIN && errno != EIO) {
            perror("write");
        }
        length = 0;
    }
}

/* The device's end of a new terminal that passes all bytes as they are; -1 where there is none. */
static int new_line(void) {
    int end = posix_openpt(O_RDWR | O_NOCTTY | O_NONBLOCK);
    if (end < 0 || grantpt(end) != 0 || unlockpt(end) != 0) {
        return -1;
    }
    const char *name = ptsname(end);
    int host = name == NULL ? -1 : open(name, O_RDWR | O_NOCTTY);
    struct termios raw;
    if (host < 0 || tcgetattr(host, &raw) != 0) {
        return -1;
    }
    raw.c_iflag &= ~(tcflag_t)(IGNBRK | BRKINT | PARMRK | ISTRIP | INLCR | IGNCR | ICRNL | IXON);
    raw.c_oflag &= ~(tcflag_t)OPOST;
    raw.c_lflag &= ~(tcflag_t)(ECHO | ECHONL | ICANON | ISIG | IEXTEN);
    raw.c_cflag = (raw.c_cflag & ~(tcflag_t)(CSIZE | PARENB)) | CS8;
    if (tcsetattr(host, TCSANOW, &raw) != 0) {
        return -1;
    }
    close(host);
    printf("%s\n", name);
    fflush(stdout);
    return end;
}

int main(void) {
    static ls_device device;
    ls_hardware hardware = {write_lamps, NULL, write_byte, milliseconds, NULL};
    line = new_line();
    if (line < 0) {
        perror("pseudo-terminal");
        return 1;
    }
    ls_begin(&device, &hardware, (uint32_t)time(NULL) ^ (uint32_t)getpid() << 16);
    for (;;) {
        struct pollfd ends[2] = {{.fd = line, .events = POLLIN},
                                 {.fd = STDIN_FILENO, .events = POLLIN}};
        poll(ends, 2, TICK_MS);
        uint8_t bytes[256];
        if (ends[1].revents != 0 && read(STDIN_FILENO, bytes, sizeof bytes) <= 0) {
            return 0;
        }
        ssize_t got = ends[0].revents & POLLIN ? read(line, bytes, sizeof bytes) : 0;
        for (ssize_t place = 0; place < got; place++) {
            ls_take(&device, bytes[place]);
        }
        ls_tick(&device);
        if (got <= 0 && ends[0].revents & POLLHUP) {
            poll(NULL, 0, CLOSED_MS);
        }
    }
}
