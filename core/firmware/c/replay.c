/* Driftscope firmware: a log through the firmware on a PC, to see what the controller would have made of it.
 *
 *   cc -std=c99 -O2 driftscope.c ds_*.c replay.c -lm -o replay && ./replay < log.csv > out.csv
 *
 * In:  t_us,ax,ay,az,gx,gy,gz[,temperature[,moving]]   a line per sample, SI, after a line of names.
 * Out: t_us,ax,ay,az,gx,gy,gz,rate,heading,heading_sd,bias,bias_sd,at_rest
 * Not part of what runs on the controller.
 */
#include <inttypes.h>
#include <stdio.h>

#include "driftscope.h"

#define LINE 512

static void print(uint32_t t_us, const ds_output *out)
{
    (void)printf("%" PRIu32 ",%.9g,%.9g,%.9g,%.9g,%.9g,%.9g,", t_us, (double)out->accel[0], (double)out->accel[1],
                 (double)out->accel[2], (double)out->gyro[0], (double)out->gyro[1], (double)out->gyro[2]);
    (void)printf("%.9g,%.9g,%.9g,%.9g,%.9g,%d\n", (double)out->rate, (double)out->heading, (double)out->heading_sd,
                 (double)out->bias, (double)out->bias_sd, out->at_rest ? 1 : 0);
}

int main(void)
{
    static ds_state state;
    char line[LINE];
    unsigned long row = 1UL;
    int failed = 0;
    ds_init(&state, 0.0f);
    (void)printf("t_us,ax,ay,az,gx,gy,gz,rate,heading,heading_sd,bias,bias_sd,at_rest\n");
    if (fgets(line, LINE, stdin) == NULL) {
        (void)fprintf(stderr, "replay: no line of names\n");
        failed = 1;
    }
    while ((failed == 0) && (fgets(line, LINE, stdin) != NULL)) {
        ds_input in = {.temperature = DS_NO_TEMPERATURE};
        ds_output out;
        int moving = 0;
        row++;
        const int found = sscanf(line, "%" SCNu32 ",%f,%f,%f,%f,%f,%f,%f,%d", &in.t_us, &in.accel[0], &in.accel[1],
                                 &in.accel[2], &in.gyro[0], &in.gyro[1], &in.gyro[2], &in.temperature, &moving);
        if (found < 7) {
            (void)fprintf(stderr, "replay: line %lu has %d numbers, expected 7 to 9\n", row, (found < 0) ? 0 : found);
            failed = 1;
        } else {
            in.moving = moving != 0;
            (void)ds_step(&state, &in, &out);
            print(in.t_us, &out);
        }
    }
    return failed;
}
