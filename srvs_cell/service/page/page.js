// Follows the daemon's event stream and asks for the page's changing part again after each change.
"use strict";

const QUIET_MS = 6000; // three heartbeats of the server
const RETRY_MS = 2000;

const cell = document.getElementById("cell");
const lost = document.getElementById("lost");
let heardAt = Date.now();
let loading = false;
let changedMeanwhile = false;

function heard() {
  heardAt = Date.now();
  showAge();
}

function showAge() {
  const age = Date.now() - heardAt;
  const text = `${Math.round(age / 1000)} s`;
  document.getElementById("age").textContent = `${text} ago`;
  document.getElementById("lost-age").textContent = text;
  lost.hidden = age < QUIET_MS;
  document.body.classList.toggle("stale", age >= QUIET_MS);
  document.title = `${lost.hidden ? cell.querySelector("h1").textContent : "Connection lost"} - srvs-cell`;
}

// Pictures and text that stay the same stay where they are: no flicker, no lost selection.
function replaceWhatDiffers(parts) {
  if (parts.length !== cell.children.length) {
    cell.replaceChildren(...parts);
    return;
  }
  parts.forEach((part, index) => {
    const present = cell.children[index];
    if (!part.isEqualNode(present)) present.replaceWith(part);
  });
}

async function load() {
  if (loading) {
    changedMeanwhile = true;
    return;
  }
  loading = true;
  try {
    do {
      changedMeanwhile = false;
      const answer = await fetch("/page/cell", { cache: "no-store" });
      if (!answer.ok) throw new Error(`the daemon answered ${answer.status}`);
      const fresh = new DOMParser().parseFromString(await answer.text(), "text/html");
      replaceWhatDiffers([...fresh.body.children]);
    } while (changedMeanwhile);
  } catch (error) {
    console.warn("srvs-cell:", error); // the banner comes with the silence of the event stream
  } finally {
    loading = false;
  }
}

function follow() {
  const events = new EventSource("/api/v1/events");
  events.addEventListener("status", () => { heard(); load(); });
  events.addEventListener("heartbeat", heard);
  events.addEventListener("error", () => {
    if (events.readyState !== EventSource.CLOSED) return; // the browser reconnects by itself
    setTimeout(follow, RETRY_MS);
  });
}

follow();
setInterval(showAge, 1000);
