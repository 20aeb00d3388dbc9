/* The block of a law in C: time, inputs, outputs. */
#include <string.h>

#include "law.h"

typedef struct {
    double time;
    law_inputs in;
    law_outputs out;
} law_block;

static int is_running;

int block_start(unsigned char *block, const char *resources) {
    (void)block;
    (void)resources;
    return 1;
}

int block_step(unsigned char *bytes, double time, double period) {
    law_block *block = (law_block *)bytes;
    if (!is_running) law_init(block->in.joints, period);
    is_running = 1;
    block->in.time = time;
    block->in.period = period;
    memset(&block->out, 0, sizeof block->out);
    law_step(&block->in, &block->out);
    return 1;
}

void block_end(void) {
    if (is_running) law_terminate();
    is_running = 0;
}
