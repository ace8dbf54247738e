/* Driftscope firmware: gyro bias and heading by our causal filter, a block of 0.2 s at a time.
 *
 * Heading, bias as a random walk, as a Gauss-Markov process and per kelvin, and the rate that is left where a rest
 * begins, in one Kalman filter. A block in movement turns the heading by its angle less the bias; one at rest holds it
 * and measures the bias, which through the covariance also repairs the heading before. The last DS_RING blocks and the
 * states before them are kept: where a later block shows that labels were wrong, the filter goes back and comes again.
 * What leaves the ring is settled; noise levels, tail and drift are learnt from it.
 *
 * The functions follow core/imu/bias/_best_numba.py of Driftscope by name. What differs is float32: sums are made
 * about a reading of their own, the heading is a compensated sum within half a turn, the covariance is updated in
 * Joseph's form, which no rounding makes negative, and counts and times are integers.
 */
#ifndef DS_BIAS_H
#define DS_BIAS_H

#include <stdbool.h>
#include <stdint.h>

#include "ds_constants.h"
#include "ds_sum.h"
#include "ds_track.h"

#define DS_STATES 4U /* beside the heading: see ds_filter */
#define DS_OTHERS 5U /* axes beside z */

typedef struct {
    float time;     /* s; 0 where nothing was heard: the block that ends the pause takes all of it */
    float angle;    /* rad, turned by the readings */
    float lost;     /* rad^2, variance of what a gap hides */
    float count;    /* readings; 0 where they are too few */
    float mean;     /* rad/s, of clipped readings */
    float clipped;  /* rad^2/s^2, variance of clipped readings */
    float plain;    /* rad^2/s^2, variance of the readings */
    float raw;      /* rad/s, mean of the readings */
    float kelvin;   /* K, over the first temperature */
    float others[DS_OTHERS]; /* variances of the other axes */
    bool moves;     /* another sensor says so */
} ds_block;

typedef struct {
    ds_sum heading;                           /* rad */
    float x[DS_STATES];                       /* bias: walk, Gauss-Markov [rad/s], per kelvin; rate left [rad/s] */
    float p[DS_STATES + 1U][DS_STATES + 1U];  /* covariance; row 0 is the heading's */
} ds_filter;

typedef struct {
    bool rests;
    bool anew;      /* the bias is forgotten here */
    uint32_t since; /* blocks since the rest began */
    float sign;     /* of the movement before: -1, 0, 1 */
} ds_mark;

typedef struct {
    ds_block block;
    ds_filter before;    /* the state before the block */
    ds_mark mark;
    float bias;          /* rad/s, after the block */
    float bias_variance; /* rad^2/s^2 */
} ds_slot;

typedef struct {
    float reading; /* rad^2/s^2, variance of a reading at rest; 0 before anything is known */
    float spread;  /* relative, of a block's variance */
    float noise;   /* rad^2/s^2, variance of a block's mean of clipped readings */
    float white;   /* rad^2/s^2, the same of plain readings */
    float held;    /* readings per block */
    float learnt;  /* blocks learnt from */
    float walk;    /* rad^2/s^3, K^2 */
    float swing;   /* rad^2/s^2, variance of the Gauss-Markov process */
    float others[DS_OTHERS];
} ds_level;

typedef struct { /* the steadiest block since the last rest */
    float variance; /* rad^2/s^2, of a reading; 0 where there is none */
    float count;
    float others[DS_OTHERS];
} ds_quietest;

typedef struct {
    float sum; /* rad/s, of the present rest */
    float held;
    float mean; /* rad/s, signed by the movement */
    float variance;
    float rests;
    float one;  /* rad^2/s^2, variance of what one rest shows */
    float used; /* rad/s, the mean as far as it is no chance */
} ds_bin;

typedef struct {
    float weight;
    float b, f;          /* rad/s */
    float bb, bf, ff;    /* their covariance */
} ds_candidate;

typedef struct { /* the block that is being read */
    float reading[DS_BLOCK_MOST];
    uint32_t count;
    uint32_t unheard;    /* blocks before this one in which nothing was heard */
    uint32_t clock_us;   /* since the last edge, at the last reading */
    float last;          /* rad/s, the last reading */
    float ahead;         /* rad, what the last block had gone on beyond its last reading */
    ds_sum turned;       /* rad, since the last edge */
    float lost;          /* rad^2 */
    float first[DS_OTHERS], one[DS_OTHERS], two[DS_OTHERS]; /* the other axes: origin, sums about it */
    float warm_first, warm_sum; /* deg C */
    uint32_t warm_count;
    bool moves;
    float recent[DS_RECENT]; /* rad/s, the last readings: the rate before a gap */
    uint32_t recent_count;
    float gap_s, gap_before, gap_at, gap_after; /* the gap that waits for the readings behind it */
    uint32_t gap_count;      /* of those */
    uint32_t gap_until_us;   /* the edge at which it is settled */
    bool gap_waits;
} ds_gather;

typedef struct {
    ds_filter filter;
    ds_slot slot[DS_RING];
    ds_level level;
    ds_bin bin[DS_BINS];
    float tail_mean[DS_TABLE];
    float tail_variance[DS_TABLE];
    ds_candidate bank[DS_BANK];
    float start_bias, start_variance; /* before the rest that is being learnt from */
    float last_mean, last_raw;        /* of the block that was learnt from last */
    float group_sum, group_noise, group_time;
    uint32_t group_count;
    uint32_t grouped;
    uint32_t at;         /* blocks taken in */
    uint32_t began;      /* the block in which the present rest may have begun */
    uint32_t refused;    /* quiet blocks that their mean spoke against */
    uint32_t vetoed;     /* blocks since anything passed for rest */
    ds_quietest quietest;
    float driving;       /* rad^2/s^2, lower quartile of a block's variance in movement */
    bool fresh;          /* the rest's beginning is still to be told */
    ds_mark old;         /* of the block that was learnt from last */
    bool old_known;
    float warm;          /* deg C, running mean */
    float warm_origin;
    float warm_block;    /* deg C, the last block's that had one */
    bool warm_known;
    bool running;        /* a first reading has come */
    ds_gather gather;
} ds_bias;

void ds_bias_init(ds_bias *state);

/* One sample. Most only add to the block; the one that ends it runs the filter. */
void ds_bias_step(ds_bias *state, const ds_bias_input *in, ds_bias_view *view);

/* The parts, in the order of a block's way; for ds_bias.c only. */
uint32_t ds_judge(ds_bias *s, uint32_t k);
void ds_advance(ds_bias *s, uint32_t k);
void ds_set_level(ds_bias *s, uint32_t k);
void ds_raise_level(ds_bias *s, uint32_t k, float scatter);
void ds_learn(ds_bias *s, const ds_slot *settled);

static inline ds_slot *ds_slot_of(ds_bias *s, uint32_t k)
{
    return &s->slot[k % DS_RING];
}

static inline bool ds_heard(const ds_block *block)
{
    return block->count >= 2.0f;
}

static inline float ds_noise_of(const ds_level *level, float count)
{
    return (level->noise * level->held) / ((count > 1.0f) ? count : 1.0f);
}

static inline float ds_least(float a, float b)
{
    return (a < b) ? a : b;
}

static inline float ds_most(float a, float b)
{
    return (a > b) ? a : b;
}

#endif
