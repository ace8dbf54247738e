/* Driftscope firmware: sums and angles in float32 that do not lose what is small.
 *
 * A float32 has 24 bits. A heading near 3 rad is a multiple of 2.4e-7 rad; added to it at 400 Hz, a rate below
 * 1e-4 rad/s would be lost altogether. So what is summed for long is kept as a pair, the sum and what it has lost
 * (Knuth's two-sum), and angles are kept within half a turn. -ffast-math would optimise this away: do not use it.
 */
#ifndef DS_SUM_H
#define DS_SUM_H

#ifdef __FAST_MATH__
#error "compensated sums need the order of operations kept: compile without -ffast-math"
#endif

#include <stdint.h>

#define DS_PI 3.14159274f           /* rad */
#define DS_TURN_HI 6.28318548f      /* rad, 2 pi in float32 ... */
#define DS_TURN_LO (-1.74845553e-7f) /* rad, ... and what it lacks */

#define DS_MICRO 1.0e6f

/* Stamps are integers, so that no time is ever lost. Divided, not multiplied by 1e-6f, which is no exact float32 and
 * would be an error of scale. */
static inline float ds_seconds(uint32_t microseconds)
{
    return (float)microseconds / DS_MICRO;
}

typedef struct {
    float hi; /* the sum, rounded */
    float lo; /* what rounding lost */
} ds_sum;

static inline ds_sum ds_sum_of(float value)
{
    const ds_sum made = {value, 0.0f};
    return made;
}

static inline float ds_sum_value(ds_sum sum)
{
    return sum.hi + sum.lo;
}

static inline ds_sum ds_sum_add(ds_sum sum, float value)
{
    const float rough = sum.hi + value;
    const float taken = rough - sum.hi;
    const float lost = (sum.hi - (rough - taken)) + (value - taken);
    const float low = sum.lo + lost;
    ds_sum made;
    made.hi = rough + low;
    made.lo = low - (made.hi - rough);
    return made;
}

static inline ds_sum ds_sum_join(ds_sum sum, ds_sum other)
{
    return ds_sum_add(ds_sum_add(sum, other.lo), other.hi);
}

/* The same angle within half a turn of 0: mostly one turn less or none; many at once where a long pause or a wild
 * reading made it large. */
static inline ds_sum ds_angle_wrap(ds_sum angle)
{
    ds_sum made = angle;
    while ((made.hi > DS_PI) || (made.hi < -DS_PI)) {
        const float turns = (float)(int32_t)(made.hi / DS_TURN_HI);
        const float less = (made.hi > 0.0f) ? 1.0f : -1.0f;
        const float taken = ((turns > 1.0f) || (turns < -1.0f)) ? turns : less;
        made = ds_sum_add(ds_sum_add(made, -(taken * DS_TURN_HI)), -(taken * DS_TURN_LO));
    }
    return made;
}

#endif
