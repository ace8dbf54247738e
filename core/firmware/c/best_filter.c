/* Driftscope firmware: the Kalman filter over one block by its label. See ds_bias.h. */
#include <math.h>
#include <stddef.h>

#include "ds_bias.h"

#define N (DS_STATES + 1U)

typedef struct {
    float mean;  /* rad/s, of what is left of the movement */
    float fresh; /* its variance that comes new */
    float keep;  /* and the share of the old that stays */
} remainder_of;

/* exp(-time / tau), known for a block of the usual length. */
static float decay(float time, float usual, float tau)
{
    float kept = usual;
    if (time <= 0.0f) {
        kept = 1.0f;
    } else if (time > DS_BLOCK_S) {
        kept = expf(-time / tau);
    } else {
        /* as usual */
    }
    return kept;
}

static remainder_of left_over(const ds_bias *s, uint32_t since, float time)
{
    const float kept = decay(time, DS_TAIL_KEEP, DS_TAIL_TAU);
    remainder_of left = {0.0f, 0.0f, kept};
    if (since < DS_TABLE) {
        const float now = s->tail_variance[since];
        left.mean = s->tail_mean[since];
        if (since == 0U) {
            left.fresh = now;
            left.keep = 0.0f;
        } else {
            const float past = s->tail_variance[since - 1U];
            left.fresh = now * (1.0f - (kept * kept));
            left.keep = (past > 0.0f) ? (kept * sqrtf(now / past)) : 0.0f;
        }
    }
    return left;
}

/* p = f p f^T, with f that of the block: the heading gains `into` times the other states, which keep `keep` of
 * themselves. */
static void predict_covariance(float p[N][N], const float into[N], const float keep[N])
{
    float gained[N] = {0.0f};
    for (size_t j = 0U; j < N; j++) {
        for (size_t k = 1U; k < N; k++) {
            gained[j] += into[k] * p[k][j];
        }
    }
    for (size_t j = 0U; j < N; j++) {
        p[0][j] += gained[j];
    }
    for (size_t k = 1U; k < N; k++) {
        p[0][0] += into[k] * p[0][k];
    }
    for (size_t i = 0U; i < N; i++) {
        for (size_t j = i; j < N; j++) {
            p[i][j] *= keep[i] * keep[j];
            p[j][i] = p[i][j];
        }
    }
}

/* Joseph's form, (1 - g h) p (1 - g h)^T + g r g^T, a side at a time: a first rest shrinks the bias' variance by nine
 * digits, more than float32 has for a difference. */
static void update_covariance(float p[N][N], const float gain[N], const float h[N], float noise)
{
    float seen[N] = {0.0f};
    for (size_t j = 0U; j < N; j++) {
        for (size_t k = 1U; k < N; k++) {
            seen[j] += h[k] * p[k][j];
        }
    }
    for (size_t i = 0U; i < N; i++) {
        for (size_t j = 0U; j < N; j++) {
            p[i][j] -= gain[i] * seen[j];
        }
    }
    for (size_t i = 0U; i < N; i++) {
        float left = 0.0f;
        for (size_t k = 1U; k < N; k++) {
            left += p[i][k] * h[k];
        }
        for (size_t j = 0U; j < N; j++) {
            p[i][j] += gain[j] * ((noise * gain[i]) - left);
        }
    }
    for (size_t i = 0U; i < N; i++) {
        for (size_t j = i + 1U; j < N; j++) {
            p[i][j] = 0.5f * (p[i][j] + p[j][i]);
            p[j][i] = p[i][j];
        }
    }
}

static void update(ds_filter *filter, const ds_block *b, float tail, float noise)
{
    const float h[N] = {0.0f, 1.0f, 1.0f, b->kelvin, 1.0f};
    float gain[N];
    float total = noise;
    float expected = tail;
    for (size_t i = 0U; i < N; i++) {
        gain[i] = 0.0f;
        for (size_t j = 1U; j < N; j++) {
            gain[i] += filter->p[i][j] * h[j];
        }
        total += h[i] * gain[i];
    }
    for (size_t i = 0U; i < DS_STATES; i++) {
        expected += h[i + 1U] * filter->x[i];
    }
    const float residual = b->mean - expected;
    for (size_t i = 0U; i < N; i++) {
        gain[i] /= total;
    }
    filter->heading = ds_sum_add(filter->heading, gain[0] * residual);
    for (size_t i = 0U; i < DS_STATES; i++) {
        filter->x[i] += gain[i + 1U] * residual;
    }
    update_covariance(filter->p, gain, h, noise);
}

/* The bias is elsewhere now: where this block says. */
static void forget_bias(ds_filter *filter, const ds_block *b)
{
    filter->x[0] = b->mean - filter->x[1] - (filter->x[2] * b->kelvin);
    for (size_t i = 0U; i < N; i++) {
        filter->p[1][i] = 0.0f;
        filter->p[i][1] = 0.0f;
    }
    filter->p[1][1] = DS_FIRST_VARIANCE;
}

static float bias_of(const ds_filter *filter, float kelvin)
{
    return filter->x[0] + filter->x[1] + (filter->x[2] * kelvin);
}

static float bias_variance_of(const ds_filter *filter, float kelvin)
{
    const float h[N] = {0.0f, 1.0f, 1.0f, kelvin, 0.0f};
    float sum = 0.0f;
    for (size_t i = 1U; i < N; i++) {
        for (size_t j = 1U; j < N; j++) {
            sum += h[i] * filter->p[i][j] * h[j];
        }
    }
    return sum;
}

/* The block's count since the rest began and the sign of the movement, from the block before. */
static void follow_marks(ds_bias *s, uint32_t k)
{
    ds_slot *const slot = ds_slot_of(s, k);
    slot->mark.since = 0U;
    slot->mark.sign = 0.0f;
    if (k > 0U) {
        const ds_mark *const last = &ds_slot_of(s, k - 1U)->mark;
        slot->mark.sign = last->sign;
        if (slot->mark.rests && last->rests) {
            slot->mark.since = last->since + 1U;
        }
    }
    if (!slot->mark.rests) {
        const float off = slot->block.raw - bias_of(&s->filter, slot->block.kelvin);
        if ((off * off) > (9.0f * s->level.noise)) {
            slot->mark.sign = (off > 0.0f) ? 1.0f : -1.0f;
        }
    }
}

/* A block in movement: the heading turns by the readings less the bias. */
static void move(ds_filter *filter, const ds_block *b, float white, float markov)
{
    const float into[N] = {0.0f, -b->time, -b->time, -(b->time * b->kelvin), 0.0f};
    const float keep[N] = {1.0f, 1.0f, markov, 1.0f, 0.0f};
    filter->heading = ds_sum_add(filter->heading, b->angle);
    filter->heading = ds_sum_add(filter->heading, -(b->time * bias_of(filter, b->kelvin)));
    filter->x[3] = 0.0f;
    predict_covariance(filter->p, into, keep);
    filter->p[0][0] += (white * b->time) + b->lost;
}

/* A block at rest: the heading turns by what is left of the movement. */
static void rest(ds_filter *filter, float time, const remainder_of *left, float markov)
{
    const float gained = 0.5f * time * (1.0f + left->keep);
    const float into[N] = {0.0f, 0.0f, 0.0f, 0.0f, gained};
    const float keep[N] = {1.0f, 1.0f, markov, 1.0f, left->keep};
    filter->heading = ds_sum_add(filter->heading, gained * filter->x[3]);
    filter->heading = ds_sum_add(filter->heading, time * left->mean);
    filter->x[3] *= left->keep;
    predict_covariance(filter->p, into, keep);
    filter->p[4][4] += left->fresh;
}

/* What a stop's beginning may hide; all of it where the movement ended unheard. */
static void begin_rest(ds_bias *s, uint32_t k, float white)
{
    const ds_block *const b = &ds_slot_of(s, k)->block;
    ds_filter *const filter = &s->filter;
    filter->p[0][0] += DS_STOP * DS_STOP * white;
    if ((k > 0U) && !ds_heard(&ds_slot_of(s, k - 1U)->block)) {
        filter->heading = ds_sum_add(filter->heading, b->angle);
        filter->heading = ds_sum_add(filter->heading, -(b->time * bias_of(filter, b->kelvin)));
        filter->p[0][0] += b->lost + (white * b->time);
    }
}

void ds_advance(ds_bias *s, uint32_t k)
{
    ds_slot *const slot = ds_slot_of(s, k);
    const ds_block *const b = &slot->block;
    ds_filter *const filter = &s->filter;
    const float white = s->level.white * DS_BLOCK_S;
    const float markov = decay(b->time, DS_MARKOV_KEEP, DS_MARKOV_TAU);
    remainder_of left = {0.0f, 0.0f, 0.0f};
    slot->before = *filter;
    if (slot->mark.anew) {
        forget_bias(filter, b);
    }
    follow_marks(s, k);
    if (slot->mark.rests) {
        if (slot->mark.since == 0U) {
            begin_rest(s, k, white);
        }
        left = left_over(s, slot->mark.since, b->time);
        left.mean *= slot->mark.sign;
        rest(filter, b->time, &left, markov);
    } else {
        move(filter, b, white, markov);
    }
    filter->x[1] *= markov;
    filter->p[1][1] += s->level.walk * b->time;
    filter->p[2][2] += s->level.swing * (1.0f - (markov * markov));
    if (slot->mark.rests && ds_heard(b)) {
        update(filter, b, left.mean, ds_noise_of(&s->level, b->count));
    }
    filter->heading = ds_angle_wrap(filter->heading);
    slot->bias = bias_of(filter, b->kelvin);
    slot->bias_variance = bias_variance_of(filter, b->kelvin);
}
