/* Replays in.bin through the firmware into out.bin: on the host by stdio, on the emulated board by semihosting.
 * A record in is {t_us, accel[3], gyro[3], temperature, moving}, nine words; out thirteen: accel[3], gyro[3],
 * rate, heading, heading_sd, bias, bias_sd, at_rest | status << 8, instructions. */
#include <stdbool.h>
#include <stdint.h>
#include <string.h>

#include "driftscope.h"
#include "port.h"

#define WORDS_IN 9U
#define WORDS_OUT 13U
#define BATCH 256U

static ds_state state;
static uint32_t in_words[BATCH * WORDS_IN];
static uint32_t out_words[BATCH * WORDS_OUT];

static void replay(const uint32_t *from, uint32_t *to)
{
    ds_input in;
    ds_output out;
    in.t_us = from[0];
    memcpy(in.accel, &from[1], sizeof in.accel);
    memcpy(in.gyro, &from[4], sizeof in.gyro);
    memcpy(&in.temperature, &from[7], sizeof in.temperature);
    in.moving = from[8] != 0U;
    port_start();
    const ds_status status = ds_step(&state, &in, &out);
    to[12] = port_stop();
    memcpy(to, &out, 11U * sizeof *to);
    to[11] = (out.at_rest ? 1U : 0U) | ((uint32_t)status << 8U);
}

int main(void)
{
    ds_init(&state, UPTIME_S);
    port_open();
    uint32_t got = port_read(in_words, sizeof in_words);
    while (got > 0U) {
        const uint32_t rows = got / (WORDS_IN * 4U);
        for (uint32_t i = 0U; i < rows; i++) {
            replay(&in_words[i * WORDS_IN], &out_words[i * WORDS_OUT]);
        }
        port_write(out_words, rows * WORDS_OUT * 4U);
        got = port_read(in_words, sizeof in_words);
    }
    port_close();
    return 0;
}
