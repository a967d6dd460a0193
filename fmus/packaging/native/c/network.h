/* The bus of a network FMU after FMI-LS-BUS for CAN: it sends frames at their periods, with what the model gives then,
 * and what it receives are values of the model's variables. Codes and layout of operations are those of version 1.0.
 *
 * Frames are due at start + k period, k = 0, 1, ...; the clock Tx_Clock counts down to the next.
 */
#ifndef NETWORK_H
#define NETWORK_H

#include "instance.h"

enum { LONGEST_RECEIVED = 4096, MOST_FRAMES = 256, LONGEST_OUTBOX = 32768 };

typedef struct {
    int tx, rx; /* whether the clocks tick now */
    int told;   /* whether the importer knows when the next frame is due */
    size_t out_size, in_size;
    unsigned char out[LONGEST_OUTBOX], in[LONGEST_RECEIVED];
    double sent[MOST_FRAMES]; /* how often each was */
    unsigned count[MOST_FRAMES]; /* of a frame that is received: its latest good counter, and 1 */
    int limited; /* whether a value that did not fit was told */
} Network;

void network_begin(Network *bus);

/* In event mode: tick a clock; get and set the operations; end an event. */
Status network_tick(Network *bus, Instance *it, unsigned reference);
Status network_get(Network *bus, Instance *it, unsigned reference, size_t *size, const unsigned char **data);
Status network_set(Network *bus, Instance *it, unsigned reference, size_t size, const unsigned char *data);
void network_update(Network *bus, Instance *it);

/* Time until the next frame is due [s]; whether that is new. */
int network_interval(Network *bus, const Instance *it, double *interval);
int network_has_interval(unsigned reference);

#endif
