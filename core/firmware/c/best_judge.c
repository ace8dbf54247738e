/* Driftscope firmware: does a block rest, and were the last ones labelled rightly? See ds_bias.h. */
#include <math.h>
#include <stddef.h>

#include "ds_bias.h"

static const uint32_t scales[DS_SCALES] = DS_SCALE_BLOCKS;

typedef struct {
    float off;      /* rad/s, mean of the last blocks less the bias before them */
    float variance; /* of that in rest */
} difference;

/* The oldest block that is still kept when k is the newest. */
static uint32_t oldest_of(uint32_t k)
{
    return (k >= DS_RING) ? (k - (DS_RING - 1U)) : 0U;
}

static difference apart(ds_bias *s, uint32_t k, uint32_t scale)
{
    const uint32_t low = k + 1U - scale;
    const ds_slot *const old = ds_slot_of(s, low - 1U);
    float total = 0.0f;
    float held = 0.0f;
    float span = 0.0f;
    for (uint32_t i = low; i <= k; i++) {
        const ds_block *const b = &ds_slot_of(s, i)->block;
        span += b->time;
        total += (b->mean - old->bias) * b->count; /* differences: small numbers keep their digits */
        held += b->count;
    }
    const difference made = {
        .off = total / held,
        .variance = ds_noise_of(&s->level, held) + old->bias_variance
                    + (s->level.walk * span) + s->level.swing,
    };
    return made;
}

/* The largest scale at which the rest's mean is not the bias before it; 0 where all agree. */
static uint32_t too_far(ds_bias *s, uint32_t k)
{
    uint32_t found = 0U;
    for (size_t i = 0U; i < DS_SCALES; i++) {
        const uint32_t scale = scales[i];
        if (((k + 1U) < (s->began + scale)) || (k < (oldest_of(k) + scale))) {
            break;
        }
        const difference d = apart(s, k, scale);
        if ((d.off * d.off) > (DS_GATE * DS_GATE * d.variance)) {
            found = scale;
        }
    }
    return found;
}

/* Whether the last window's mean speaks against a rest's beginning here. */
static bool off_at_entry(ds_bias *s, uint32_t k)
{
    bool off = false;
    if (k >= DS_WINDOW) {
        const difference d = apart(s, k, DS_WINDOW);
        off = (d.off * d.off) > (DS_ENTER * DS_ENTER * d.variance);
    }
    return off;
}

/* Sum of squares of the last blocks' means about their mean, as if none were missing; beyond any threshold where half
 * of them are. */
static float scatter(ds_bias *s, uint32_t k, uint32_t window)
{
    const float origin = ds_slot_of(s, k)->block.mean;
    float one = 0.0f;
    float two = 0.0f;
    float found = INFINITY;
    uint32_t n = 0U;
    for (uint32_t i = 0U; (i < window) && (i <= k); i++) {
        const ds_block *const b = &ds_slot_of(s, k - i)->block;
        if (ds_heard(b)) {
            const float d = b->mean - origin;
            one += d;
            two += d * d;
            n++;
        }
    }
    if (((k + 1U) >= window) && ((2U * n) > window)) {
        found = ds_most(two - ((one * one) / (float)n), 0.0f) * ((float)(window - 1U) / (float)(n - 1U));
    }
    return found;
}

static bool calm(const ds_bias *s, const ds_block *b)
{
    return b->clipped < (s->level.reading * (1.0f + (DS_FAR * s->level.spread)));
}

/* One block's mean with the bias before it, if there was one, within `most` deviations. */
static bool agrees(ds_bias *s, uint32_t i, float most)
{
    const ds_block *const b = &ds_slot_of(s, i)->block;
    bool good = calm(s, b) && !b->moves && (b->count > 0.0f);
    if (good && (i > 0U)) {
        const ds_slot *const old = ds_slot_of(s, i - 1U);
        const float off = b->mean - old->bias;
        const float spread = ds_noise_of(&s->level, b->count) + old->bias_variance + s->level.swing;
        good = (off * off) < (most * most * spread);
    }
    return good;
}

/* How many blocks of the window are too loud for rest: one by itself is an outlier's or a knock's, and ends no rest. */
static uint32_t loud(ds_bias *s, uint32_t k, uint32_t window)
{
    const float most = s->level.reading * (1.0f + (DS_FAR * s->level.spread));
    uint32_t found = 0U;
    for (uint32_t i = 0U; (i < window) && (i <= k); i++) {
        if (ds_slot_of(s, k - i)->block.clipped > most) {
            found++;
        }
    }
    return found;
}

/* Whether half of the window before k was not heard. */
static bool thin(ds_bias *s, uint32_t k)
{
    uint32_t missing = 0U;
    for (uint32_t i = 1U; (i < DS_WINDOW) && (i <= k); i++) {
        if (!ds_heard(&ds_slot_of(s, k - i)->block)) {
            missing++;
        }
    }
    return (2U * missing) >= DS_WINDOW;
}

/* Whether block k ends a window of rest as far as one can say without the bias. */
static bool quiet(ds_bias *s, uint32_t k, bool resting)
{
    const ds_block *const b = &ds_slot_of(s, k)->block;
    const ds_level *const level = &s->level;
    const float most = 1.0f + (2.0f * DS_FAR * ds_most(level->spread, 0.1f));
    bool rests = (level->reading > 0.0f) && (b->count >= ds_least(4.0f, 0.5f * level->held)) && !b->moves;
    for (size_t a = 0U; a < DS_OTHERS; a++) {
        rests = rests && (b->others[a] <= (level->others[a] * most));
    }
    if (rests) {
        const bool calm_enough = resting ? (loud(s, k, DS_WINDOW) <= 1U) : (loud(s, k, 1U) == 0U);
        if (!(calm_enough && (scatter(s, k, DS_WINDOW) < (DS_EVEN * level->noise)))) {
            /* or it shakes in rest, but less than in movement */
            rests = (b->plain < (0.5f * s->driving))
                    && (scatter(s, k, 3U * DS_WINDOW) < (DS_STEADY * level->noise));
        }
    }
    return rests;
}

/* How many blocks of the movement that shows in block k lie before it, and one. */
static uint32_t onset(ds_bias *s, uint32_t k)
{
    const float sign = (ds_slot_of(s, k)->block.raw > ds_slot_of(s, k - 1U)->bias) ? 1.0f : -1.0f;
    const float least = 1.5f * sqrtf(s->level.noise);
    uint32_t back = 2U;
    for (uint32_t i = 2U; (i < 6U) && (k > (oldest_of(k) + i)); i++) {
        const float off = sign * (ds_slot_of(s, k - i)->block.mean - ds_slot_of(s, k - i - 1U)->bias);
        if (off < least) {
            break;
        }
        back = i + 1U;
    }
    return back;
}

/* Blocks before k that were taken for rest and are the movement's beginning, or its end. */
static uint32_t take_back(ds_bias *s, uint32_t k, uint32_t back)
{
    uint32_t low = k;
    const uint32_t reach = ((k + 1U) > back) ? (k + 1U - back) : 0U;
    uint32_t i = (reach > oldest_of(k)) ? reach : oldest_of(k);
    for (; i < k; i++) {
        ds_mark *const mark = &ds_slot_of(s, i)->mark;
        if (mark->rests) {
            mark->rests = false;
            low = (i < low) ? i : low;
        }
    }
    return low;
}

/* A rest told from a window began inside it. Little of it is taken: what creeps in here is lost, and bends the bias as
 * well. At the very start all of it. */
static uint32_t begin_earlier(ds_bias *s, uint32_t k)
{
    const uint32_t back = (k < DS_WINDOW) ? DS_WINDOW : (DS_WINDOW / 2U);
    uint32_t low = k;
    for (uint32_t i = 1U; (i < back) && (k >= (oldest_of(k) + i)); i++) {
        if (!agrees(s, k - i, 1.5f)) {
            break;
        }
        low = k - i;
        ds_slot_of(s, low)->mark.rests = true;
    }
    return low;
}

/* Labels a block in which something was heard; how many before it have to be relabelled. */
static uint32_t label(ds_bias *s, uint32_t k)
{
    ds_mark *const mark = &ds_slot_of(s, k)->mark;
    const bool resting = (k > 0U) && ds_slot_of(s, k - 1U)->mark.rests;
    bool still = quiet(s, k, resting);
    if (resting && !still && thin(s, k)) { /* just after a pause: the window says nothing */
        still = agrees(s, k, DS_ENTER);
    }
    const uint32_t far = still ? too_far(s, k) : 0U;
    uint32_t back = 0U;
    if (!still) {
        s->began = k + 1U;
        s->refused = 0U;
        s->fresh = true;
        back = resting ? onset(s, k) : 0U;
    } else if (far > 0U) {
        s->refused += far;
        s->began = k + 1U;
        s->fresh = false;
        back = far;
        if (s->refused >= DS_PATIENCE) {
            mark->anew = true;
            s->refused = 0U;
        }
    } else if (!resting && off_at_entry(s, k)) {
        s->refused++;
        s->fresh = true;
    } else {
        mark->rests = true;
        s->vetoed = 0U;
        s->quietest.variance = 0.0f;
        if (k >= (s->began + scales[DS_SCALES - 1U])) {
            s->refused = 0U;
        }
    }
    if (!mark->rests) {
        ds_raise_level(s, k, scatter(s, k, 3U * DS_WINDOW));
    }
    return back;
}

uint32_t ds_judge(ds_bias *s, uint32_t k)
{
    ds_slot *const slot = ds_slot_of(s, k);
    uint32_t low = k;
    if (!ds_heard(&slot->block)) { /* nothing was heard: it goes on as it was */
        slot->mark.rests = (k > 0U) && ds_slot_of(s, k - 1U)->mark.rests;
    } else {
        const uint32_t back = label(s, k);
        if (back > 0U) {
            low = take_back(s, k, back);
        } else if (s->fresh && slot->mark.rests) {
            s->fresh = false;
            low = begin_earlier(s, k);
        } else {
            /* the labels stand */
        }
    }
    return low;
}
