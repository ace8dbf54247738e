/* Driftscope firmware: readings gathered into blocks, and each block's way through the filter. See ds_bias.h. */
#include "ds_bias.h"

#include <math.h>
#include <stddef.h>
#include <string.h>

static void begin_block(ds_gather *g)
{
    g->count = 0U;
    g->warm_count = 0U;
    g->lost = 0.0f;
    g->turned = ds_sum_of(0.0f);
    g->moves = false;
}

void ds_bias_init(ds_bias *state)
{
    (void)memset(state, 0, sizeof *state);
    state->filter.p[1][1] = DS_FIRST_VARIANCE;
    state->filter.p[2][2] = DS_GIVEN_SWING;
    state->filter.p[3][3] = DS_SLOPE_VARIANCE;
    state->level.walk = DS_GIVEN_WALK;
    state->level.swing = DS_GIVEN_SWING;
#if !DS_NOISE_GIVEN
    static const float prior[DS_BANK] = DS_BANK_FIRST;
    for (size_t i = 0U; i < DS_BANK; i++) {
        state->bank[i].weight = prior[i];
    }
#endif
}

/* Mean and variance about it of the block's readings, each drawn to within `reach` of `middle`. */
static void moments(const ds_gather *g, float middle, float reach, float *mean, float *variance)
{
    const float n = (float)g->count;
    float first = 0.0f;
    float second = 0.0f;
    for (size_t i = 0U; i < g->count; i++) {
        const float d = ds_most(ds_least(g->reading[i] - middle, reach), -reach);
        first += d;
        second += d * d;
    }
    const float shift = first / n;
    *mean = middle + shift;
    *variance = ds_most(second - (n * shift * shift), 0.0f) / (n - 1.0f);
}

/* Temperature over the first known one, a running mean over some seconds; the last known one holds. */
static float kelvin_of(ds_bias *s)
{
    const ds_gather *const g = &s->gather;
    if (g->warm_count >= 2U) {
        s->warm_block = g->warm_first + (g->warm_sum / (float)g->warm_count);
        if (!s->warm_known) {
            s->warm_known = true;
            s->warm_origin = s->warm_block;
            s->warm = 0.0f;
        }
    }
    if (s->warm_known) {
        s->warm += DS_WARMTH * ((s->warm_block - s->warm_origin) - s->warm);
    }
    return s->warm;
}

static void describe(ds_bias *s, ds_block *b)
{
    const ds_gather *const g = &s->gather;
    const float n = (float)g->count;
    b->count = 0.0f;
    b->raw = 0.0f;
    b->plain = 0.0f;
    b->mean = 0.0f;
    b->clipped = 0.0f;
    for (size_t a = 0U; a < DS_OTHERS; a++) {
        b->others[a] = 0.0f;
    }
    if (g->count >= 2U) {
        b->count = n;
        moments(g, g->reading[0], INFINITY, &b->raw, &b->plain);
        b->mean = b->raw;
        b->clipped = b->plain;
        if (s->level.reading > 0.0f) {
            moments(g, b->raw, DS_CLIP * sqrtf(s->level.reading), &b->mean, &b->clipped);
        }
        for (size_t a = 0U; a < DS_OTHERS; a++) {
            b->others[a] = ds_most(g->two[a] - ((g->one[a] * g->one[a]) / n), 0.0f) / (n - 1.0f);
        }
    }
    b->time = 0.0f;
    if (ds_heard(b)) {
        b->time = DS_BLOCK_S * (float)(g->unheard + 1U);
        s->gather.unheard = 0U;
    } else {
        s->gather.unheard++;
    }
    b->kelvin = kelvin_of(s);
    b->moves = g->moves;
}

/* A block is over: learn from the one that leaves the ring, label, and filter, again from where labels changed. */
static void take_block(ds_bias *s, float angle)
{
    const uint32_t k = s->at;
    ds_slot *const slot = ds_slot_of(s, k);
    if (k >= DS_RING) {
        ds_learn(s, slot);
    }
    describe(s, &slot->block);
    slot->block.angle = angle;
    slot->block.lost = s->gather.lost;
    slot->mark.rests = false;
    slot->mark.anew = false;
    ds_set_level(s, k);
    const uint32_t low = ds_judge(s, k);
    if (low < k) {
        s->filter = ds_slot_of(s, low)->before;
    }
    for (uint32_t i = low; i <= k; i++) {
        ds_advance(s, i);
    }
    s->at = k + 1U;
}

/* Ends the block at its edge, `behind_us` after the last reading: the rate goes on for two samples at most. */
static void end_block(ds_bias *s, uint32_t behind_us)
{
    ds_gather *const g = &s->gather;
    const uint32_t on_us = (behind_us < DS_GO_ON_US) ? behind_us : DS_GO_ON_US;
    const float ahead = g->last * ds_seconds(on_us);
    const ds_sum turned = ds_sum_add(ds_sum_add(g->turned, -g->ahead), ahead);
    take_block(s, ds_sum_value(turned));
    begin_block(g);
    g->ahead = ahead;
}

/* Over a gap the rate is the middle between those beside it, known as if it lay anywhere between them. */
static void settle_gap(ds_gather *g)
{
    if (g->gap_waits) {
        const float after = g->gap_after / (float)g->gap_count;
        const float apart = g->gap_s * (after - g->gap_before);
        g->turned = ds_sum_add(g->turned, g->gap_s * ((0.5f * (g->gap_before + after)) - g->gap_at));
        g->lost += (apart * apart) / 12.0f;
        g->gap_waits = false;
    }
}

static void begin_gap(ds_gather *g, uint32_t step_us, float z)
{
    float before = 0.0f;
    const uint32_t known = (g->recent_count < DS_RECENT) ? g->recent_count : DS_RECENT;
    for (size_t i = 0U; i < known; i++) {
        before += g->recent[i];
    }
    g->gap_s = ds_seconds(step_us);
    g->gap_before = before / (float)known;
    g->gap_at = z;
    g->gap_after = 0.0f;
    g->gap_count = 0U;
    g->gap_waits = true;
    /* The gap is settled at the next edge of the 10 Hz curve, by the readings up to there. */
    g->gap_until_us = ((g->clock_us + (DS_CELL_US - 1U)) / DS_CELL_US) * DS_CELL_US;
}

static void take_reading(ds_gather *g, const ds_bias_input *in)
{
    const float z = in->rate;
    g->turned = ds_sum_add(g->turned, z * ds_seconds(in->step_us));
    if (in->step_us > DS_GAP_US) {
        begin_gap(g, in->step_us, z);
    }
    if (g->gap_waits && (g->gap_count < DS_RECENT)) {
        g->gap_after += z;
        g->gap_count++;
    }
    g->last = z;
    g->recent[g->recent_count % DS_RECENT] = z;
    g->recent_count++;
    if (g->count < DS_BLOCK_MOST) {
        for (size_t a = 0U; a < DS_OTHERS; a++) {
            if (g->count == 0U) {
                g->first[a] = in->others[a];
                g->one[a] = 0.0f;
                g->two[a] = 0.0f;
            }
            const float d = in->others[a] - g->first[a];
            g->one[a] += d;
            g->two[a] += d * d;
        }
        g->reading[g->count] = z;
        g->count++;
    }
    if (in->temperature > DS_NO_TEMPERATURE) {
        if (g->warm_count == 0U) {
            g->warm_first = in->temperature;
            g->warm_sum = 0.0f;
        }
        g->warm_sum += in->temperature - g->warm_first;
        g->warm_count++;
    }
    g->moves = g->moves || in->moving;
}

/* Variance of flicker that is too fast for rests to show, yet part of the bias. */
static float too_fast(const ds_level *level)
{
    const float white = level->white * DS_BLOCK_S;
    return (white > 0.0f) ? (DS_FAST * DS_FAST * level->swing / (1.0f + (DS_SHOWN * level->swing / white))) : 0.0f;
}

static void show(const ds_bias *s, ds_bias_view *view)
{
    const ds_gather *const g = &s->gather;
    const bool any = s->at > 0U;
    const ds_slot *const last = &s->slot[any ? ((s->at - 1U) % DS_RING) : 0U];
    ds_sum now = s->filter.heading;
    view->at_rest = any && last->mark.rests;
    view->bias = any ? last->bias : 0.0f;
    view->bias_sd = any ? sqrtf(ds_most(last->bias_variance, 0.0f) + too_fast(&s->level)) : DS_UNKNOWN;
    view->heading_sd = sqrtf(ds_most(s->filter.p[0][0], 0.0f));
    if (!view->at_rest) { /* between blocks, the readings since */
        now = ds_sum_add(ds_sum_join(now, g->turned), -g->ahead);
        now = ds_sum_add(now, -(view->bias * ds_seconds(g->clock_us)));
    }
    view->heading = ds_sum_value(ds_angle_wrap(now));
}

void ds_bias_step(ds_bias *state, const ds_bias_input *in, ds_bias_view *view)
{
    ds_gather *const g = &state->gather;
    if (!state->running) { /* the first reading only begins the first block */
        begin_block(g);
        g->last = in->rate;
        g->recent[0] = in->rate;
        g->recent_count = 1U;
        state->running = true;
    } else {
        uint32_t behind_us = DS_BLOCK_US - g->clock_us;
        g->clock_us += in->step_us;
        while (g->clock_us > DS_BLOCK_US) { /* an edge lies before this reading; after a pause, several */
            settle_gap(g);
            end_block(state, behind_us);
            behind_us += DS_BLOCK_US;
            g->clock_us -= DS_BLOCK_US;
        }
        if (g->clock_us > g->gap_until_us) {
            settle_gap(g);
        }
        take_reading(g, in);
        if (g->clock_us == DS_BLOCK_US) { /* this reading stands on the edge: no need to wait for the next */
            settle_gap(g);
            end_block(state, 0U);
            g->clock_us = 0U;
        }
    }
    show(state, view);
}
