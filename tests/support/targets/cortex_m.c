/* SPDX-License-Identifier: MIT */
/* Start of a Cortex-M with an FPU, up to newlib's own start, whose input and output are the debugger's (semihosting). */
extern void _start(void);

static void reset(void)
{
    *(volatile unsigned *)0xE000ED88u |= 0xFu << 20; /* CPACR: full access to the FPU */
    __asm__ volatile("dsb\n\tisb");
    _start();
}

static void stop(void)
{
    for (;;) {
    }
}

__attribute__((section(".vectors"), used)) static void (*const vectors[])(void) = {
    (void (*)(void))0x20400000, reset, stop, stop, stop, stop, stop,
};
