/* Driftscope firmware: Algorithm 1 of Kolhoff & Kemper (ICINCO 2021) for every sample, then the bias tracker. */
#include "driftscope.h"

#include <math.h>
#include <stddef.h>
#include <string.h>

static const float static_bias[DS_AXES] = DS_STATIC_BIAS;
static const float drift_amplitude[DS_AXES] = DS_DRIFT_AMPLITUDE;
static const float drift_rate[DS_AXES] = DS_DRIFT_RATE;
static const float accel_inverse[3][3] = DS_ACCEL_INVERSE;
static const float gyro_inverse[3][3] = DS_GYRO_INVERSE;

#define HALF_RANGE 0x80000000U /* a step of the clock beyond this is one backwards */

/* What no sensor reads is no reading: it is not finite, or far beyond every range. */
static bool sound(float reading)
{
    return (isfinite(reading) != 0) && (fabsf(reading) < DS_LARGEST);
}

/* y = m x */
static void multiply(const float m[3][3], const float x[3], float y[3])
{
    for (size_t i = 0U; i < 3U; i++) {
        y[i] = (m[i][0] * x[0]) + (m[i][1] * x[1]) + (m[i][2] * x[2]);
    }
}

/* Lines 4 to 6: an axis' drifting and static bias at this sample. The recursion g = (1 - T/Tc) g is kept as a
 * compensated sum of its small changes: 1 - T/Tc itself, of a gyro's hour at 100 Hz, has two digits in float32. */
static float bias_now(ds_sum *markov, size_t j, float dt)
{
    float share = dt * drift_rate[j];
    if (share > 1.0f) { /* a pause longer than Tc: Euler's step would swing below zero */
        share = 1.0f;
    }
    *markov = ds_sum_add(*markov, -(share * ds_sum_value(*markov)));
    return static_bias[j] + (drift_amplitude[j] * ((1.0f - markov->hi) - markov->lo));
}

/* Line 7. The running sum would gather rounding for ever; so each time the ring begins anew it is replaced by a sum of
 * the ring's own readings. */
static void average_add(ds_average *average, float value)
{
    if (average->filled < DS_MA_LENGTH) {
        average->total += value;
        average->filled++;
    } else {
        average->total += value - average->ring[average->place];
    }
    average->ring[average->place] = value;
    average->fresh += value;
    average->place++;
    if (average->place == DS_MA_LENGTH) {
        average->place = 0U;
        average->total = average->fresh;
        average->fresh = 0.0f;
    }
}

/* Mean of the last DS_MA_LENGTH readings, of those there are at first; 0 on an axis that never gave one. */
static float average_value(const ds_average *average)
{
    return (average->filled > 0U) ? (average->total / (float)average->filled) : 0.0f;
}

/* Algorithm 1 for one sample: the corrected output, and without average in `now`. */
static void correct(ds_state *state, const ds_input *in, float dt, float now[DS_AXES])
{
    float mean[DS_AXES];
    float instant[DS_AXES];
    for (size_t j = 0U; j < DS_AXES; j++) {
        const float reading = (j < 3U) ? in->accel[j] : in->gyro[j - 3U];
        const float bias = bias_now(&state->markov[j], j, dt);
        const bool good = sound(reading);
        if (good) {
            average_add(&state->average[j], reading - bias);
        }
        mean[j] = average_value(&state->average[j]);
        instant[j] = good ? (reading - bias) : mean[j];
    }
    multiply(accel_inverse, &mean[0], state->last.accel); /* line 8 */
    multiply(gyro_inverse, &mean[3], state->last.gyro);
    multiply(accel_inverse, &instant[0], &now[0]);
    multiply(gyro_inverse, &instant[3], &now[3]);
}

static void track(ds_state *state, const ds_input *in, const float now[DS_AXES])
{
    const ds_bias_input sample = {
        .step_us = state->waited_us,
        .rate = now[5],
        .others = {now[3], now[4], now[0], now[1], now[2]},
        .temperature = in->temperature,
        .moving = in->moving,
    };
    ds_bias_view view;
    ds_bias_step(&state->bias, &sample, &view);
    state->waited_us = 0U;
    state->last.rate = now[5] - view.bias;
    state->last.heading = view.heading;
    state->last.heading_sd = view.heading_sd;
    state->last.bias = view.bias;
    state->last.bias_sd = view.bias_sd;
    state->last.at_rest = view.at_rest;
}

void ds_init(ds_state *state, float uptime_s)
{
    (void)memset(state, 0, sizeof *state);
    for (size_t j = 0U; j < DS_AXES; j++) {
        state->markov[j] = ds_sum_of(expf(-uptime_s * drift_rate[j]));
    }
    ds_bias_init(&state->bias);
    state->last.bias_sd = DS_UNKNOWN;
    state->last.heading_sd = DS_UNKNOWN;
}

static bool forward(uint32_t step_us)
{
    return (step_us > 0U) && (step_us < HALF_RANGE);
}

/* Time since the last sample, 0 at the first; whether that can be. A clock that jumped back is followed from the
 * second sample on; the time between is not known and counts as none. */
static bool time_of(ds_state *state, uint32_t t_us, uint32_t *step_us)
{
    bool good = true;
    *step_us = 0U;
    if (state->started) {
        *step_us = t_us - state->last_us;
        if (!forward(*step_us) && state->jumped) {
            *step_us = t_us - state->jumped_us;
        }
        good = forward(*step_us);
        state->jumped = !good;
        state->jumped_us = t_us;
    }
    return good;
}

ds_status ds_step(ds_state *state, const ds_input *in, ds_output *out)
{
    ds_status status = DS_OK;
    uint32_t step_us;
    if (!time_of(state, in->t_us, &step_us)) {
        status = DS_BAD_TIME;
    } else {
        float now[DS_AXES];
        correct(state, in, ds_seconds(step_us), now);
        if (state->waited_us < HALF_RANGE) { /* a longer wait without a rate is one of that length: no overflow */
            state->waited_us += step_us;
        }
        if (sound(in->gyro[2])) {
            track(state, in, now);
        } else {
            status = DS_BAD_READING;
        }
        state->last_us = in->t_us;
        state->started = true;
    }
    *out = state->last;
    return status;
}
