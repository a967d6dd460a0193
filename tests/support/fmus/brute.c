/* Ways in which a binary fails that no status tells of; put between an FMI adapter and the runtime of a native FMU. */
#define _GNU_SOURCE
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <unistd.h>

#include "instance.h"

enum { CALM, SEGMENTATION, ABORT, EXIT, HANG, PRINT, DEAF, GARBAGE, ORPHAN, LAST_WORDS, BAD_END };

static int mood(const Instance *it)
{
    return (int)it->now.values[vr_mood];
}

#ifdef NEVER_LOADED
__attribute__((constructor)) static void load(void)
{
    for (;;)
        pause();
}
#endif

static void misbehave(Instance *it)
{
    switch (mood(it)) {
    case SEGMENTATION:
        raise(SIGSEGV);
        break;
    case ABORT:
        abort();
    case EXIT:
        exit(7);
    case HANG:
        for (;;)
            pause();
    case DEAF: /* as programs do that become daemons */
        for (int file = 3; file < 256; file++)
            close(file);
        break;
    case GARBAGE:
        for (int file = 3; file < 64; file++)
            if (write(file, "\3\0\0\0r[}[\3\0\0\0r[}[", 16) < 0)
                continue;
        break;
    case ORPHAN: /* leaves a process behind */
        if (fork() == 0)
            execlp("sleep", "sleep", "600", (char *)NULL);
        raise(SIGSEGV);
        break;
    case LAST_WORDS:
        instance_error(it, "out of %s", "luck");
        raise(SIGSEGV);
        break;
    default:
        break;
    }
}

Status brute_step(Instance *it, double time, double duration)
{
    if (mood(it) == PRINT)
        puts("here I am");
    if (time >= it->now.values[vr_at] - 1e-9)
        misbehave(it);
    return instance_step(it, time, duration);
}

void brute_close(Instance *it)
{
    if (mood(it) == BAD_END)
        raise(SIGSEGV);
    instance_close(it);
}
