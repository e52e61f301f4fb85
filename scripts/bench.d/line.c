/* The client of the benchmark and its plainest peer, both on a pty.
 *
 *   line client COUNT PATH     opens PATH
 *   line client COUNT -        makes a pty, prints its path, and starts when a line comes on standard input
 *   line echo                  makes a pty, prints its path, and answers every request with the same bytes
 *
 * The client asks COUNT times for ten holding registers of unit 1 and prints the seconds that took. */
#define _GNU_SOURCE
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

enum { REQUEST = 8, REPLY = 25 };

static int make(void) {
    int master = posix_openpt(O_RDWR | O_NOCTTY);
    if (master < 0 || grantpt(master) || unlockpt(master)) { perror("pty"); exit(1); }
    struct termios settings;
    int kept = open(ptsname(master), O_RDWR | O_NOCTTY);
    tcgetattr(kept, &settings);
    cfmakeraw(&settings);
    tcsetattr(kept, TCSANOW, &settings);
    puts(ptsname(master));
    fflush(stdout);
    return master;
}

static void take(int line, unsigned char *bytes, int count) {
    while (count > 0) {
        ssize_t got = read(line, bytes, count);
        if (got <= 0) { perror("read"); exit(1); }
        bytes += got;
        count -= got;
    }
}

int main(int argc, char **argv) {
    unsigned char request[REQUEST], reply[REPLY] = {1, 3, 20};
    if (argc == 2 && !strcmp(argv[1], "echo")) {
        int line = make();
        for (;;) {
            take(line, request, REQUEST);
            if (write(line, reply, REPLY) != REPLY) return 1;
        }
    }
    if (argc != 4) return 2;
    long count = atol(argv[2]);
    int line;
    if (!strcmp(argv[3], "-")) {
        line = make();
        if (getchar() == EOF) return 1;
    } else {
        line = open(argv[3], O_RDWR | O_NOCTTY);
        if (line < 0) { perror(argv[3]); return 1; }
        struct termios settings;
        tcgetattr(line, &settings);
        cfmakeraw(&settings);
        tcsetattr(line, TCSANOW, &settings);
    }
    /* Read ten holding registers from 0 of unit 1; the CRC is C5 CD. */
    static const unsigned char ask[REQUEST] = {1, 3, 0, 0, 0, 10, 0xC5, 0xCD};
    struct timespec from, to;
    clock_gettime(CLOCK_MONOTONIC, &from);
    for (long done = 0; done < count; done++) {
        if (write(line, ask, REQUEST) != REQUEST) return 1;
        take(line, reply, REPLY);
        if (reply[1] != 3) { fprintf(stderr, "exception %d\n", reply[2]); return 1; }
    }
    clock_gettime(CLOCK_MONOTONIC, &to);
    printf("%f\n", to.tv_sec - from.tv_sec + (to.tv_nsec - from.tv_nsec) / 1e9);
    return 0;
}
