"""Conventions of the library. Everything in `core` leans on this page; nothing here runs.

Units     SI and radians everywhere. Degrees, per-hour and percent exist only in `app/figures`.
Time      `t` is float64 seconds from the start of the run, strictly increasing within a stream.
Axes      REP-103: x forward, y left, z up. Headings counter-clockwise from the map's x axis.
Frames    map (m): where beacons and truth live. body (b): origin at the midpoint of the drive axle.
          imu (i): mounted at (x, y, yaw) in the body. tag: the beacon receiver, at (x, y, z) in the body.
          A suffix names the frame a vector is expressed in (`velocity_b`); a bare `pose` is the body in the map.
Arrays    one-dimensional columns of equal length, NaN where the source has no value. Never changed in place.
          Readings keep the precision of their source (float32 or float64); kernels convert to float64 themselves.
Poses     (N, 3) rows of x [m], y [m], theta [rad]; covariances (N, 3, 3) in the same order, in the map frame.
Names     r wheel radius, b track width, v forward speed, w turn rate, N angle random walk, B bias instability,
          K rate random walk. `sd_` is one standard deviation.
Results   frozen dataclasses of arrays, an uncertainty beside each estimate. Reasons are text with advice.
Errors    one family, `core.errors`; a message says what is wrong, where, what was expected and what was found.

Rooms, in import order (a room imports only from those before it):
`errors` `geometry` `timing` `robot` `trajectory` `sensors` `run` `formats` `metrics` `imu` `effects` `simulation`
`estimation` `gap`.
"""
