/* The harness on QEMU's mps2-an500, a Cortex-M7: files by Arm semihosting, instructions counted by SysTick.
 *
 * QEMU counts instructions, not cycles: with -icount shift=6 each lasts 64 ns of the board's time, and SysTick runs at
 * the board's 25 MHz, so 8 ticks are 5 instructions. */
#ifndef PORT_H
#define PORT_H

#include <stdint.h>

#define SYST_CSR (*(volatile uint32_t *)0xE000E010U)
#define SYST_RVR (*(volatile uint32_t *)0xE000E014U)
#define SYST_CVR (*(volatile uint32_t *)0xE000E018U)
#define SYST_TOP 0x00FFFFFFU

void port_open(void);
uint32_t port_read(void *to, uint32_t bytes);
void port_write(const void *from, uint32_t bytes);
void port_close(void);

extern uint32_t port_began;

static inline void port_start(void)
{
    port_began = SYST_CVR;
}

static inline uint32_t port_stop(void)
{
    const uint32_t ticks = (port_began - SYST_CVR) & SYST_TOP;
    return ((ticks * 5U) + 4U) / 8U;
}

#endif
