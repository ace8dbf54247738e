/* Driftscope firmware: what is learnt from blocks whose labels stand: noise levels, the tail of movements, how the bias
 * drifts. See ds_bias.h. */
#include <math.h>
#include <stddef.h>
#include <string.h>

#include "ds_bias.h"

static const uint32_t edges[DS_BINS + 1U] = DS_BIN_EDGES;
static const float bin_first[DS_BINS] = DS_BIN_FIRST;
static const float bin_usual[DS_BINS] = DS_BIN_USUAL;

static float clip(float value, float most)
{
    return ds_most(ds_least(value, most), -most);
}

/* A mean that may as well be chance would turn every rest the same way: it is drawn to 0. */
static float beyond_chance(const ds_bin *bin)
{
    const float chance = DS_DOUBT * bin->one / (bin->rests + 1.0f);
    const float square = bin->mean * bin->mean;
    return (square > chance) ? (bin->mean * (1.0f - (chance / square))) : 0.0f;
}

/* What of the mean is not used counts as variance. */
static float with_unused(const ds_bin *bin)
{
    const float unused = bin->mean - bin->used;
    return bin->variance + (unused * unused);
}

/* The tail by blocks since the rest began: straight lines between the bins' middles, never rising. */
static void tabulate(ds_bias *s)
{
    size_t i = 0U;
    for (size_t j = 0U; j < DS_BINS; j++) {
        s->bin[j].used = beyond_chance(&s->bin[j]);
    }
    /* Of the first blocks only those were taken for rest whose noise hid the creep: told from the next two bins. */
    if ((s->bin[1].used * s->bin[2].used) > 0.0f) {
        s->bin[0].used = s->bin[1].used * sqrtf(ds_most(s->bin[1].used / s->bin[2].used, 1.0f));
    }
    for (uint32_t k = 0U; k < DS_TABLE; k++) {
        const float at = (float)k + 0.5f;
        while ((i < (DS_BINS - 2U)) && (at > (0.5f * (float)(edges[i + 1U] + edges[i + 2U])))) {
            i++;
        }
        const float left = 0.5f * (float)(edges[i] + edges[i + 1U]);
        const float right = 0.5f * (float)(edges[i + 1U] + edges[i + 2U]);
        const float u = ds_least(ds_most((at - left) / (right - left), 0.0f), 1.0f);
        const ds_bin *const a = &s->bin[i];
        const ds_bin *const b = &s->bin[i + 1U];
        s->tail_mean[k] = ((1.0f - u) * a->used) + (u * b->used);
        s->tail_variance[k] = ds_most(((1.0f - u) * with_unused(a)) + (u * with_unused(b)), 0.0f);
    }
    /* Early on a rest shows too little: what stood out was not taken for one. */
    for (uint32_t k = DS_TABLE - 1U; k > 0U; k--) {
        s->tail_variance[k - 1U] = ds_most(s->tail_variance[k - 1U], s->tail_variance[k]);
    }
}

#if !DS_NOISE_GIVEN
static const float bank_walk[DS_BANK] = DS_BANK_WALK;
static const float bank_swing[DS_BANK] = DS_BANK_SWING;

/* K^2 and Gauss-Markov variance: means over the candidates. */
static void set_drift(ds_bias *s, float white)
{
    float walk = 0.0f;
    float swing = 0.0f;
    for (size_t i = 0U; i < DS_BANK; i++) {
        walk += s->bank[i].weight * bank_walk[i];
        swing += s->bank[i].weight * bank_swing[i];
    }
    s->level.walk = walk * white;
    s->level.swing = swing * white;
}
#endif

/* What goes with the white noise: drift and tail begin as usual for a gyro of this noise. */
static void scale(ds_bias *s)
{
#if DS_NOISE_GIVEN
    const float white = DS_GIVEN_WHITE;
#else
    const float white = s->level.white * DS_BLOCK_S;
    set_drift(s, white);
    s->filter.p[2][2] = ds_most(s->filter.p[2][2], s->level.swing);
#endif
    for (size_t i = 0U; i < DS_BINS; i++) {
        s->bin[i].mean = 0.0f;
        s->bin[i].rests = 0.0f;
        s->bin[i].one = 0.0f;
        s->bin[i].variance = bin_first[i] * white;
    }
    tabulate(s);
}

/* A new level: everything that is learnt begins again from it. */
static void begin_level(ds_bias *s, uint32_t k, float reading, float plain, float held)
{
    s->level.reading = reading;
    s->level.spread = sqrtf(2.0f / (held - 1.0f));
    s->level.noise = reading / held;
    s->level.white = plain / held;
    s->level.held = held;
    s->level.learnt = 0.0f;
    for (size_t a = 0U; a < DS_OTHERS; a++) {
        s->level.others[a] = 0.0f;
        for (uint32_t i = 0U; (i < DS_WINDOW) && (i <= k); i++) {
            s->level.others[a] += ds_slot_of(s, k - i)->block.others[a] / (float)DS_WINDOW;
        }
    }
    scale(s);
}

/* The first level of noise, or a new one where a window of blocks is far quieter than what passed for rest. */
void ds_set_level(ds_bias *s, uint32_t k)
{
    const float share = 1.0f / (float)DS_WINDOW;
    float most = 0.0f;
    float total = 0.0f;
    float plain = 0.0f;
    float held = 0.0f;
    bool whole = (k + 1U) >= DS_WINDOW;
    for (uint32_t i = 0U; whole && (i < DS_WINDOW); i++) {
        const ds_block *const b = &ds_slot_of(s, k - i)->block;
        most = ds_most(most, b->clipped);
        total += b->clipped * share;
        plain += b->plain * share;
        held += b->count * share;
        whole = ds_heard(b);
    }
    if (whole && (total > 0.0f)) {
        /* That many deviations of a chi-square of as many degrees of freedom as the window holds (Wilson, Hilferty). */
        const float root = ds_most(1.0f - (DS_QUIETER * sqrtf(2.0f / (9.0f * (float)DS_WINDOW * (held - 1.0f)))), 0.0f);
        if ((s->level.reading <= 0.0f) || (most < (s->level.reading * root * root * root))) {
            begin_level(s, k, total, plain, held);
        }
    }
}

/* A higher level where for long nothing has passed for rest: that of the steadiest block since, if the last means
 * scatter no more than their own noise says. */
void ds_raise_level(ds_bias *s, uint32_t k, float scatter)
{
    const ds_block *const b = &ds_slot_of(s, k)->block;
    ds_quietest *const q = &s->quietest;
    const uint32_t patience = (s->level.learnt > 0.0f) ? (4U * DS_PATIENCE) : DS_PATIENCE;
    s->vetoed++;
    if (ds_heard(b) && (b->plain > 0.0f) && (scatter < (DS_STEADY * b->plain / b->count))
        && ((q->variance <= 0.0f) || (b->plain < q->variance))) {
        q->variance = b->plain;
        q->count = b->count;
        (void)memcpy(q->others, b->others, sizeof q->others);
    }
    if (s->vetoed >= patience) {
        s->vetoed = 0U;
        if (q->variance > 0.0f) {
            begin_level(s, k, q->variance, q->variance, q->count);
            (void)memcpy(s->level.others, q->others, sizeof q->others);
        }
        q->variance = 0.0f;
    }
}

static void learn_levels(ds_bias *s, const ds_block *b)
{
    ds_level *const level = &s->level;
    level->learnt += 1.0f;
    const float share = 1.0f / ds_least(level->learnt + 10.0f, 1500.0f);
    const float off = (b->clipped / level->reading) - 1.0f;
    level->spread += share * ((1.25f * ds_least(fabsf(off), 4.0f * level->spread)) - level->spread);
    level->spread = ds_most(level->spread, 0.7f * sqrtf(2.0f / ds_most(level->held - 1.0f, 1.0f)));
    level->spread = ds_least(level->spread, 0.8f);
    level->reading += level->reading * share * ds_least(off, 3.0f);
    level->held += share * (b->count - level->held);
    for (size_t a = 0U; a < DS_OTHERS; a++) {
        level->others[a] += share * (b->others[a] - level->others[a]);
    }
    if (s->old_known && s->old.rests) {
        const float clipped = b->mean - s->last_mean;
        const float plain = b->raw - s->last_raw;
        level->noise += share * (ds_least(0.5f * clipped * clipped, 8.0f * level->noise) - level->noise);
        level->white += share * (ds_least(0.5f * plain * plain, 25.0f * level->white) - level->white);
    }
}

/* What was left of the movement, in the bins that this rest of `length` blocks filled. */
static void end_of_rest(ds_bias *s, uint32_t length)
{
    const float white = s->level.white * DS_BLOCK_S;
    for (size_t i = 0U; i < DS_BINS; i++) {
        ds_bin *const bin = &s->bin[i];
        const float whole = (float)(edges[i + 1U] - edges[i]);
        const bool filled = (bin->held >= whole) && ((edges[i + 1U] + 4U) <= length);
        /* The bias before must be known well enough to tell what is left from it. */
        if (filled && (fabsf(s->old.sign) > 0.5f) && (s->start_variance <= s->level.noise)) {
            const float known = (s->level.noise / bin->held) + s->start_variance;
            const float most = 16.0f * (known + ds_most(bin->variance, 0.0f));
            const float d = (s->old.sign * bin->sum / bin->held) - bin->mean;
            const float usual = (bin_usual[i] * white) + (1.0e-3f * known);
            const float prior = known / usual; /* rests that the mean's prior, 0, counts for */
            bin->rests += 1.0f;
            bin->mean += clip(d, sqrtf(most)) / ds_least(bin->rests + prior, 1000.0f);
            bin->variance += (ds_least(d * d, most) - known - bin->variance)
                             / ds_least(bin->rests + DS_TAIL_PRIOR, 400.0f);
            bin->one += (known + ds_most(bin->variance, 0.0f) - bin->one) / ds_least(bin->rests, 400.0f);
        }
    }
    tabulate(s);
}

static void learn_tail(ds_bias *s, const ds_slot *settled)
{
    const uint32_t since = settled->mark.since;
    if ((since == 0U) || !(s->old_known && s->old.rests)) {
        for (size_t i = 0U; i < DS_BINS; i++) {
            s->bin[i].sum = 0.0f;
            s->bin[i].held = 0.0f;
        }
    }
    for (size_t i = 0U; i < DS_BINS; i++) {
        if ((since >= edges[i]) && (since < edges[i + 1U])) {
            s->bin[i].sum += settled->block.mean - s->start_bias;
            s->bin[i].held += 1.0f;
        }
    }
    if (since == DS_TABLE) {
        end_of_rest(s, DS_TABLE + 5U);
    }
}

#if !DS_NOISE_GIVEN
/* One candidate after a mean `off` time since the last: its weight by its likelihood, its bias by a Kalman filter. */
static void weigh(ds_candidate *q, float mean, float noise, float gap, float walk, float swing)
{
    const float phi = expf(-gap / DS_MARKOV_TAU);
    q->f *= phi;
    q->bb += walk * gap;
    q->bf *= phi;
    q->ff = (q->ff * phi * phi) + (swing * (1.0f - (phi * phi)));
    const float gain_b = q->bb + q->bf;
    const float gain_f = q->bf + q->ff;
    const float spread = gain_b + gain_f + noise;
    const float off = mean - q->b - q->f;
    q->weight *= expf(-0.5f * ds_least((off * off) / spread, 16.0f)) / sqrtf(spread / noise);
    q->b += (gain_b / spread) * off;
    q->f += (gain_f / spread) * off;
    q->bb -= gain_b * (gain_b / spread);
    q->bf -= gain_b * (gain_f / spread);
    q->ff -= gain_f * (gain_f / spread);
}

/* Means over a group of blocks weigh the candidates. */
static void learn_drift(ds_bias *s, const ds_slot *settled)
{
    const uint32_t since = settled->mark.since;
    const float left = (since < DS_TABLE) ? (settled->mark.sign * s->tail_mean[since]) : 0.0f;
    s->group_sum += settled->block.mean - (s->filter.x[2] * settled->block.kelvin) - left;
    s->group_noise += s->level.noise;
    s->group_count++;
    s->group_time += settled->block.time;
    if (s->group_count >= DS_GROUP) {
        const float groups = (float)DS_GROUP;
        const float tail = (since < DS_TABLE) ? s->tail_variance[since] : 0.0f;
        const float mean = s->group_sum / groups;
        const float noise = (s->group_noise / (groups * groups)) + tail;
        const float gap = s->group_time;
        const float white = s->level.white * DS_BLOCK_S;
        float total = 0.0f;
        for (size_t i = 0U; i < DS_BANK; i++) {
            ds_candidate *const q = &s->bank[i];
            if (s->grouped == 0U) {
                q->b = mean;
                q->f = 0.0f;
                q->bb = noise;
                q->bf = 0.0f;
                q->ff = bank_swing[i] * white;
            } else {
                weigh(q, mean, noise, gap, bank_walk[i] * white, bank_swing[i] * white);
            }
            total += q->weight;
        }
        for (size_t i = 0U; i < DS_BANK; i++) {
            s->bank[i].weight = (DS_BANK_KEEP * (s->bank[i].weight / total)) + DS_BANK_FLOOR;
        }
        s->grouped = 1U;
        s->group_sum = 0.0f;
        s->group_noise = 0.0f;
        s->group_count = 0U;
        s->group_time = 0.0f;
        set_drift(s, white);
    }
}
#endif

/* The lower quartile of the blocks' variances: it goes up by a third of what it goes down. */
static void learn_driving(ds_bias *s, float plain)
{
    if (s->driving <= 0.0f) {
        s->driving = plain;
    }
    s->driving *= (plain > s->driving) ? 1.0025f : 0.9925f;
}

void ds_learn(ds_bias *s, const ds_slot *settled)
{
    const ds_mark *const mark = &settled->mark;
    const bool heard = ds_heard(&settled->block);
    if (mark->rests) {
        if (heard) {
            learn_levels(s, &settled->block);
            learn_tail(s, settled);
#if !DS_NOISE_GIVEN
            learn_drift(s, settled);
#endif
        }
    } else {
        if (s->old_known && s->old.rests && (s->old.since < DS_TABLE)) {
            end_of_rest(s, s->old.since);
        }
        s->group_time += settled->block.time;
        s->group_sum = 0.0f;
        s->group_noise = 0.0f;
        s->group_count = 0U;
        s->start_bias = settled->bias;
        s->start_variance = settled->bias_variance;
        learn_driving(s, settled->block.plain);
    }
    if (heard) {
        s->old = *mark;
        s->old_known = true;
        s->last_mean = settled->block.mean;
        s->last_raw = settled->block.raw;
    }
}
