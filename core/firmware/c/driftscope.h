/* Driftscope firmware: six IMU axes corrected (Kolhoff & Kemper 2021, Algorithm 1), gyro bias and heading tracked.
 *
 * Use: one ds_state per IMU, anywhere but on a short stack; ds_init once; ds_step for every sample. No heap, no
 * global state, no I/O, no interrupt-unsafe statics: two IMUs are two states. From libm only sqrtf and expf.
 * Units are SI: m/s^2, rad/s, rad, s, degrees Celsius.
 */
#ifndef DRIFTSCOPE_H
#define DRIFTSCOPE_H

#include <stdbool.h>
#include <stdint.h>

#include "ds_bias.h"
#include "ds_constants.h"
#include "ds_sum.h"

#define DS_AXES 6U /* ax, ay, az, gx, gy, gz: the order of everything six long */

typedef struct {
    uint32_t t_us;     /* microseconds of a free-running clock; it may wrap (every 71.6 minutes) */
    float accel[3];    /* m/s^2, specific force as read; an axis without a reading: NAN */
    float gyro[3];     /* rad/s, as read; the same */
    float temperature; /* deg C of the die; DS_NO_TEMPERATURE where there is none */
    bool moving;       /* wheels turn or are told to; false where that is not known */
} ds_input;

typedef struct {
    float accel[3];   /* m/s^2, Algorithm 1: bias, drift, noise and misalignment removed; 20 samples late */
    float gyro[3];    /* rad/s, the same */
    float rate;       /* rad/s about z without delay: corrected, not averaged, less `bias` */
    float heading;    /* rad within half a turn, 0 at the first sample, counter-clockwise */
    float heading_sd; /* rad, one standard deviation; DS_UNKNOWN where the method states none */
    float bias;       /* rad/s that the tracker finds about z on top of the calibration */
    float bias_sd;    /* rad/s; DS_UNKNOWN before the first rest */
    bool at_rest;     /* the tracker's verdict on its last segment or block */
} ds_output;

typedef enum {
    DS_OK = 0,
    DS_BAD_READING = 1, /* the rate about z is no reading (not finite, or beyond DS_LARGEST): bias and heading wait */
    DS_BAD_TIME = 2     /* the clock stood still or ran backwards (or a pause was over 35 minutes): the sample is left
                           out, the output is the last one; a clock that jumped is followed from the next sample on */
} ds_status;

typedef struct {
    float ring[DS_MA_LENGTH]; /* the last readings without bias */
    float total;              /* their sum */
    float fresh;              /* sum of those since the ring last began anew */
    uint32_t place;           /* next in the ring */
    uint32_t filled;          /* readings in the ring */
} ds_average;

typedef struct {
    ds_sum markov[DS_AXES]; /* g of Algorithm 1: 1 when switched on, decaying */
    ds_average average[DS_AXES];
    uint32_t last_us;   /* stamp of the last sample */
    uint32_t waited_us; /* from the last rate about z that the tracker got, to last_us */
    uint32_t jumped_us; /* stamp of a sample whose clock could not be */
    bool jumped;
    bool started;
    ds_bias bias;
    ds_output last;
} ds_state;

/* uptime_s: how long the IMU has been powered already; 0 where it is switched on with the controller. */
void ds_init(ds_state *state, float uptime_s);

/* One sample in, one result out. The status says whether the sample was used. */
ds_status ds_step(ds_state *state, const ds_input *in, ds_output *out);

#endif
