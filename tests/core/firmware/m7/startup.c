/* Start-up of a Cortex-M7 for tests under QEMU: vectors, floating point on, memory made, main, and what the harness
 * needs of Arm semihosting. */
#include <stdint.h>

#include "port.h"

#define SYS_OPEN 0x01U
#define SYS_CLOSE 0x02U
#define SYS_WRITE 0x05U
#define SYS_READ 0x06U
#define SYS_EXIT 0x18U
#define EXIT_DONE 0x20026U  /* ADP_Stopped_ApplicationExit: status 0 */
#define EXIT_FAULT 0x20023U /* ADP_Stopped_RunTimeError: status 1 */
#define READ_BINARY 1U
#define WRITE_BINARY 5U
#define CPACR (*(volatile uint32_t *)0xE000ED88U)

extern uint32_t stack_top, data_load, data_start, data_end, bss_start, bss_end;
int main(void);
void reset(void);
uint32_t port_began;
static uint32_t file_in, file_out;

static uint32_t semihost(uint32_t operation, uintptr_t argument)
{
    register uint32_t r0 __asm__("r0") = operation;
    register uintptr_t r1 __asm__("r1") = argument;
    __asm__ volatile("bkpt 0xAB" : "+r"(r0) : "r"(r1) : "memory");
    return r0;
}

static void fault(void)
{
    (void)semihost(SYS_EXIT, EXIT_FAULT);
    for (;;) {
    }
}

static uint32_t open(const char *name, uint32_t length, uint32_t mode)
{
    const uintptr_t block[3] = {(uintptr_t)name, mode, length};
    const uint32_t made = semihost(SYS_OPEN, (uintptr_t)block);
    if (made == UINT32_MAX) {
        fault();
    }
    return made;
}

void port_open(void)
{
    SYST_RVR = SYST_TOP;
    SYST_CVR = 0U;
    SYST_CSR = 5U; /* the processor's clock, on */
    file_in = open("in.bin", 6U, READ_BINARY);
    file_out = open("out.bin", 7U, WRITE_BINARY);
}

uint32_t port_read(void *to, uint32_t bytes)
{
    const uintptr_t block[3] = {file_in, (uintptr_t)to, bytes};
    return bytes - semihost(SYS_READ, (uintptr_t)block); /* the answer is what was not read */
}

void port_write(const void *from, uint32_t bytes)
{
    const uintptr_t block[3] = {file_out, (uintptr_t)from, bytes};
    if (semihost(SYS_WRITE, (uintptr_t)block) != 0U) {
        fault();
    }
}

void port_close(void)
{
    const uintptr_t in = file_in, out = file_out;
    (void)semihost(SYS_CLOSE, (uintptr_t)&in);
    (void)semihost(SYS_CLOSE, (uintptr_t)&out);
}

void reset(void)
{
    CPACR |= 0xFU << 20U; /* coprocessors 10 and 11: the FPU */
    __asm__ volatile("dsb\n isb");
    const uint32_t *from = &data_load;
    for (uint32_t *to = &data_start; to < &data_end; to++) {
        *to = *from++;
    }
    for (uint32_t *to = &bss_start; to < &bss_end; to++) {
        *to = 0U;
    }
    (void)main();
    (void)semihost(SYS_EXIT, EXIT_DONE);
    fault();
}

typedef void (*handler)(void);
typedef struct {
    uint32_t *stack;
    handler of[15];
} vector_table;

__attribute__((section(".vectors"), used)) static const vector_table vectors = {
    &stack_top, {reset, fault, fault, fault, fault, fault, 0, 0, 0, 0, fault, fault, 0, fault, fault}};
