"""The 3D view: viser behind the dashboard's own port, one server per open run, a cursor per viewer.

`data` what is shown, plain · `source` from the store · `shapes` geometry · `style` colours · `build` nodes ·
`cursor` a viewer's cursor, checked · `viewer` its nodes and ticks · `panel` viser's own widgets ·
`servers` open scenes · `proxy` the page and viser's websocket · `api` REST and the cursor's socket.

Addresses
    /scene/{run}/                 a scene by itself: sends on to a viewer of its own, with a panel
    /scene/{run}/{viewer}/        viser's client; `?theme=dark|light`, `?panel`, viser's `?hideViserLogo&fixedDpr=1`
    /scene/{run}/{viewer}         its websocket, passed on to the run's viser server on 127.0.0.1 and no further
    /api/v1/scenes/{run}          who looks at what: each viewer's cursor and the poses it sees
    /api/v1/scenes/{run}/cursor?viewer=KEY      a page's hand on the cursor, a WebSocket
    /api/v1/runs/{run}/files/scene.html         the scene as one file

A viewer is a key that the page invents (1 to 64 of A-Z a-z 0-9 _ -) and puts into its frame's address and its socket.
It has one cursor, whatever number of browsers show it, and lives as long as anybody looks or listens.

Page to scene: JSON text, any of
    {"t": 12.5, "playing": true, "speed": 2, "follow": true, "methods": ["fused"] | null, "theme": "dark",
     "trail": "method" | "speed" | "gap"}
t is seconds of the run. While `playing`, the server moves the robots by its own clock, so a page sends a word when
something changes and about once a second to stay in step; dragging sends t at up to 30 Hz. A page that leaves pauses.
Scene to page: {"type": "state", "by": "scene"|"page"|"panel", "clients": 1, "t": ..., "playing": ..., "poses": {...}}
at the start, when a browser comes or goes, when the run's end is reached, and when another hand moves the cursor
("panel": viser's widgets; "page": another socket of the same viewer); {"type": "problem", ...} for a wrong message.
Close codes: 4404 there is no such run, 1013 too many scenes are open.

In pages this is `static/lib/scene.js`: mountScene(container, runId, clock).
"""
