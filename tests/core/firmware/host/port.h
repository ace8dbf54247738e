/* The harness on a PC: plain files, nothing counted. */
#ifndef PORT_H
#define PORT_H

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

static FILE *port_in;
static FILE *port_out;

static inline void port_open(void)
{
    port_in = fopen("in.bin", "rb");
    port_out = fopen("out.bin", "wb");
    if ((port_in == NULL) || (port_out == NULL)) {
        exit(EXIT_FAILURE);
    }
}

static inline uint32_t port_read(void *to, uint32_t bytes)
{
    return (uint32_t)fread(to, 1, bytes, port_in);
}

static inline void port_write(const void *from, uint32_t bytes)
{
    if (fwrite(from, 1, bytes, port_out) != bytes) {
        exit(EXIT_FAILURE);
    }
}

static inline void port_close(void)
{
    (void)fclose(port_in);
    (void)fclose(port_out);
}

static inline void port_start(void) {}

static inline uint32_t port_stop(void)
{
    return 0U;
}

#endif
