// The feed of a robot (protocol: app/live/protocol.py): one socket that comes back by itself, and says how it is.
//
//   const feed = openFeed(robot, { message: (m) => {}, state: ("connecting" | "open" | "lost", seconds) => {} });
//   feed.send({ type: "drive", v, w }) -> whether it could be sent

const RETRY = [250, 500, 1000, 2000, 4000]; // ms
const QUIET = 6; // s that an open socket may say nothing at all; then it is dead

export function openFeed(robot, { message, state }) {
  const scheme = location.protocol === "https:" ? "wss:" : "ws:";
  const address = `${scheme}//${location.host}/api/v1/live/${encodeURIComponent(robot)}/watch`;
  let socket = null;
  let attempts = 0;
  let quiet = 0; // seconds, counted only while this page itself gets its turn
  let live = false; // only a robot that is live is expected to speak
  let closed = false;

  function connect() {
    if (closed) return;
    const mine = (socket = new WebSocket(address));
    quiet = 0;
    mine.addEventListener("open", () => {
      attempts = 0;
      state("open");
    });
    mine.addEventListener("message", (event) => {
      quiet = 0;
      const told = JSON.parse(event.data);
      if (told.state) live = told.state === "live";
      if (told.type === "gone") live = false;
      message(told);
    });
    mine.addEventListener("close", () => {
      if (closed || mine !== socket) return;
      socket = null;
      const wait = RETRY[Math.min(attempts++, RETRY.length - 1)];
      state("lost", wait / 1000);
      setTimeout(() => (state("connecting"), connect()), wait);
    });
  }

  setInterval(() => {
    if (socket?.readyState === WebSocket.OPEN && live && ++quiet > QUIET) socket.close();
  }, 1000);
  addEventListener("pagehide", () => {
    closed = true;
    socket?.close();
  });
  // A page that comes back out of the browser's cache goes on.
  addEventListener("pageshow", (event) => {
    if (!event.persisted) return;
    closed = false;
    connect();
  });
  state("connecting");
  connect();
  return {
    send(told) {
      if (socket?.readyState !== WebSocket.OPEN) return false;
      socket.send(JSON.stringify(told));
      return true;
    },
  };
}
