/* Driftscope firmware: method C of Cechowicz, a segment at a time. See ds_bias.h. */
#include "ds_bias.h"

#include <math.h>
#include <stddef.h>
#include <string.h>

static void begin_segment(ds_bias *state)
{
    state->held_us = 0U;
    state->count = 0U;
    state->sum = ds_sum_of(0.0f);
    state->turned = ds_sum_of(0.0f);
}

void ds_bias_init(ds_bias *state)
{
    (void)memset(state, 0, sizeof *state);
    /* Half a step early, as in Python: whatever the clock's jitter, each segment gets the same number of readings. */
    state->clock_us = DS_C_HALF_STEP_US;
    state->bias_sd = DS_UNKNOWN;
}

/* Test (7), and the mean joins those that later ones are compared with. */
static bool in_band(ds_bias *state, float mean)
{
    bool inside = true;
    if (state->filled > 0U) {
        float off = 0.0f;
        for (size_t i = 0U; i < state->filled; i++) {
            off += mean - state->before[i]; /* differences: small numbers keep their digits */
        }
        inside = fabsf(off / (float)state->filled) <= DS_C_SIGMA;
    }
    state->before[state->place] = mean;
    state->place = (state->place + 1U) % DS_C_BEFORE;
    if (state->filled < DS_C_BEFORE) {
        state->filled++;
    }
    return inside;
}

/* Judges the segment that is over and corrects the heading over it. */
static void end_segment(ds_bias *state)
{
    state->at_rest = false;
    if (state->count >= DS_C_FEWEST) {
        const float mean = state->first + (ds_sum_value(state->sum) / (float)state->count);
        if ((state->most - state->least) < DS_C_RANGE) { /* test (5) */
            state->at_rest = in_band(state, mean);
        }
        if (state->at_rest) {
            if (!state->known) { /* the first bias also holds for what was before it */
                const float before = -(mean * ((float)state->unknown_us / DS_MICRO));
                state->heading = ds_sum_add(state->heading, before);
                state->known = true;
            }
            state->bias = mean;
            state->bias_sd = DS_C_SIGMA / sqrtf((float)state->count);
        }
    }
    if (!state->known) {
        state->unknown_us += state->held_us;
    }
    state->heading = ds_sum_join(state->heading, state->turned);
    state->heading = ds_sum_add(state->heading, -(state->bias * ds_seconds(state->held_us)));
    state->heading = ds_angle_wrap(state->heading);
    begin_segment(state);
}

void ds_bias_step(ds_bias *state, const ds_bias_input *in, ds_bias_view *view)
{
    const float z = in->rate;
    state->clock_us += in->step_us;
    if (state->clock_us >= DS_C_SEGMENT_US) {
        end_segment(state);
        state->clock_us %= DS_C_SEGMENT_US;
    }
    if (state->count == 0U) {
        state->first = z;
        state->least = z;
        state->most = z;
    }
    state->least = (z < state->least) ? z : state->least;
    state->most = (z > state->most) ? z : state->most;
    state->sum = ds_sum_add(state->sum, z - state->first);
    state->turned = ds_sum_add(state->turned, z * ds_seconds(in->step_us));
    state->held_us += in->step_us;
    state->count++;

    ds_sum now = ds_sum_join(state->heading, state->turned);
    now = ds_angle_wrap(ds_sum_add(now, -(state->bias * ds_seconds(state->held_us))));
    view->heading = ds_sum_value(now);
    view->heading_sd = DS_UNKNOWN;
    view->bias = state->bias;
    view->bias_sd = state->bias_sd;
    view->at_rest = state->at_rest;
}
