// Says by itself when the page is no longer kept fresh: what stands still must not look as if it rested.
(() => {
  const LOST_MS = 2000;
  const LOST = "THE CONSOLE IS NOT RESPONDING. The data shown is out of date.";
  const CLOSED = "The case and its console are closed. ronna-console opens it again.";
  let beat = "", changed = performance.now();
  setInterval(() => {
    const clock = document.getElementById("clock");
    const lost = document.getElementById("lost");
    if (!clock || !lost) return;
    if (clock.dataset.beat !== beat) { beat = clock.dataset.beat; changed = performance.now(); }
    const gone = performance.now() - changed > LOST_MS;
    const closed = Boolean(clock.dataset.outcome);
    lost.hidden = !gone;
    lost.textContent = closed ? CLOSED : LOST;
    lost.classList.toggle("calm", closed);
    document.body.classList.toggle("past", gone || document.querySelector(".frozen") !== null);
  }, 250);
  setInterval(() => { if (window.socket && window.socket.connected) emitEvent("alive"); }, 1000);
})();
