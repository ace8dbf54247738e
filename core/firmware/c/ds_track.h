/* Driftscope firmware: what every bias tracker takes and gives. */
#ifndef DS_TRACK_H
#define DS_TRACK_H

#include <stdbool.h>
#include <stdint.h>

typedef struct {
    uint32_t step_us;  /* since the sample before; 0 for the first */
    float rate;        /* rad/s about z, corrected, not averaged */
    float others[5];   /* the other axes: rates about x and y [rad/s], specific force [m/s^2] */
    float temperature; /* deg C, DS_NO_TEMPERATURE where there is none */
    bool moving;       /* wheels turn, or are told to */
} ds_bias_input;

typedef struct {
    float heading;    /* rad, within half a turn */
    float heading_sd; /* rad, or DS_UNKNOWN */
    float bias;       /* rad/s */
    float bias_sd;    /* rad/s, or DS_UNKNOWN */
    bool at_rest;
} ds_bias_view;

#endif
