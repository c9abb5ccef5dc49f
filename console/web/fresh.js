// Says by itself when the page is no longer kept fresh: what stands still must not look as if it rested. Brings what is
// asked into view, and names what can be focused.
(() => {
  const LOST_MS = 2000;
  const MARGIN_PX = 8;
  const LOST = "THE CONSOLE IS NOT RESPONDING. The data shown is out of date.";
  const CLOSED = "The case and its console are closed. ronna-console opens it again.";
  const CONTROLS = [".stopbox", ".seatbox", ".orders", ".answerbar"].flatMap(
    place => ["button", "input"].map(control => `${place} ${control}`),
  ).join();
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
    // A page that cannot reach its console: no age grows on it any more, and no click of it arrives.
    const cut = gone && (closed || !window.socket?.connected);
    document.body.classList.toggle("cut", cut);
    for (const one of document.querySelectorAll(cut ? CONTROLS : "[data-cut]")) {
      if (cut && one.disabled) continue;
      one.disabled = cut;
      one.toggleAttribute("data-cut", cut);
    }
    document.body.classList.toggle("past", gone || document.querySelector(".frozen") !== null);
  }, 250);
  // The head stays over the page: what is asked, or focused by Tab, must not lie under it.
  let asked = "";
  setInterval(() => {
    // On a phone only its first row stays; an element without a box has no height.
    const boxes = [...document.querySelectorAll(".head, .headrow")].map(one => one.getBoundingClientRect());
    const head = boxes.find(box => box.height > 0);
    if (!head) return;
    document.documentElement.style.scrollPaddingTop = `${head.height + MARGIN_PX}px`;
    const panel = document.querySelector("section.question:has(.answers)");
    const number = panel?.querySelector("h2").dataset.question ?? "";
    if (number === asked) return;
    asked = number;
    if (!panel) return;
    const top = panel.getBoundingClientRect().top;
    if (top < head.bottom || top > window.innerHeight - head.height) panel.scrollIntoView();
  }, 250);
  // The library names a slider on its outside and focuses its inside.
  setInterval(() => {
    for (const inside of document.querySelectorAll(".q-slider[aria-label] [tabindex='0']:not([aria-label])")) {
      inside.setAttribute("role", "group");
      inside.setAttribute("aria-label", inside.closest(".q-slider").getAttribute("aria-label"));
    }
  }, 250);
  setInterval(() => { if (window.socket && window.socket.connected) emitEvent("alive"); }, 1000);
})();
