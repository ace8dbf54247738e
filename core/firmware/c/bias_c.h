/* Driftscope firmware: gyro bias by method C of Cechowicz (Acta Mechanica et Automatica 11(2), 2017).
 *
 * The rate about z is cut into segments of 3 s. A segment is at rest if its range is below 7 sigma (5) and its mean
 * lies within sigma of the mean of the DS_C_BEFORE segments before it that passed (5), (7). Its mean is then the bias,
 * of the segment itself and until the next one.
 */
#ifndef DS_BIAS_H
#define DS_BIAS_H

#include <stdbool.h>
#include <stdint.h>

#include "ds_constants.h"
#include "ds_sum.h"
#include "ds_track.h"

typedef struct {
    uint32_t clock_us;              /* since the present segment's edge */
    uint32_t held_us;               /* time that the present segment's readings stand for */
    uint32_t count;                 /* readings of the present segment */
    float first;                    /* rad/s, its first reading: the sum below is about it */
    float least;                    /* rad/s */
    float most;                     /* rad/s */
    ds_sum sum;                     /* rad/s */
    ds_sum turned;                  /* rad, raw, in the present segment */
    ds_sum heading;                 /* rad, at the present segment's beginning */
    uint64_t unknown_us;            /* time before the first segment at rest */
    float before[DS_C_BEFORE];      /* rad/s, means of segments that passed (5) */
    uint32_t place;                 /* next in `before` */
    uint32_t filled;                /* means in `before` */
    float bias;                     /* rad/s */
    float bias_sd;                  /* rad/s */
    bool known;
    bool at_rest;
} ds_bias;

void ds_bias_init(ds_bias *state);

/* One sample. Method C looks at the rate about z only. */
void ds_bias_step(ds_bias *state, const ds_bias_input *in, ds_bias_view *view);

#endif
