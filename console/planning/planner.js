// The 3-D scene takes its size only when the window's changes; tell it too when its place on the page does.
(() => {
  const watch = setInterval(() => {
    const stage = document.querySelector(".stagebox");
    if (!stage) return;
    clearInterval(watch);
    new ResizeObserver(() => window.dispatchEvent(new Event("resize"))).observe(stage);
  }, 100);
})();
