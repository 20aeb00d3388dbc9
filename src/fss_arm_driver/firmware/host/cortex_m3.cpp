// What core_pipe needs to run on a bare Cortex-M3 with semihosting, as an emulator offers it: the
// two vectors that a start reads, and a source of randomness that it never asks.

#include <stddef.h>

extern "C" void _start();
extern "C" int getentropy(void*, size_t) { return -1; }

using Handler = void (*)();
extern "C" [[gnu::section(".vectors"), gnu::used]] const Handler vectors[2] = {
    reinterpret_cast<Handler>(0x00400000), _start};  // the end of the memory, as first stack
