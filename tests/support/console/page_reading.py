"""How well a page can be read: contrast of its text as computed, names and focus of what can be pressed."""

from __future__ import annotations

import math
from typing import Any

LARGE_PX, LARGE_BOLD_PX, BOLD = 24.0, 18.66, 700  # from which text counts as large
AA, AA_LARGE = 4.5, 3.0  # WCAG 2, success criterion 1.4.3
LOW_CONTRAST = """
([large, largeBold, bold, aa, aaLarge]) => {
  const parse = colour => {
    const n = (colour.match(/[\\d.]+/g) || [0, 0, 0, 0]).map(Number);
    const scale = colour.startsWith("color(srgb") ? 255 : 1;
    return [n[0] * scale, n[1] * scale, n[2] * scale, n[3] ?? 1];
  };
  const over = (top, below) => below.map((value, k) => k < 3 ? top[k] * top[3] + value * (1 - top[3]) : 1);
  const behind = element => {
    const layers = [];
    for (let e = element; e; e = e.parentElement) layers.push(parse(getComputedStyle(e).backgroundColor));
    return layers.reverse().reduce((below, layer) => over(layer, below), [255, 255, 255, 1]);
  };
  const light = colour => {
    const [r, g, b] = colour.map(v => (v /= 255) <= 0.03928 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const found = [];
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) {
    const words = walker.currentNode.textContent.trim(), element = walker.currentNode.parentElement;
    if (!words || !element.checkVisibility({opacityProperty: true, visibilityProperty: true})) continue;
    if (element.closest("[disabled], .disabled, .q-field--disabled")) continue;
    if (element.closest(".stage, script, style, svg, .paper")) continue;
    const style = getComputedStyle(element);
    let opacity = 1;
    for (let e = element; e; e = e.parentElement) opacity *= Number(getComputedStyle(e).opacity);
    const ground = behind(element), ink = parse(style.color);
    ink[3] *= opacity;
    const a = light(over(ink, ground)), b = light(ground);
    const ratio = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
    const size = parseFloat(style.fontSize);
    const isLarge = size >= large || (size >= largeBold && Number(style.fontWeight) >= bold);
    if (ratio < (isLarge ? aaLarge : aa))
      found.push(`${ratio.toFixed(2)} ${words.slice(0, 40)} .${element.className}`);
  }
  return found;
}
"""
PRESSABLE = """
() => [...document.querySelectorAll("button, [role=combobox], input, summary, [tabindex='0']")]
  .filter(e => e.checkVisibility({visibilityProperty: true}) && !e.disabled)
  .filter(e => !e.closest("[aria-hidden=true]"))
  .map((e, k) => {
    e.dataset.pressable = k;
    const label = e.getAttribute("aria-label") || e.labels?.[0]?.innerText || e.innerText;
    return [k, (label || "").trim(), e.outerHTML.slice(0, 120)];
  })
"""
FOCUSED = """
() => {
  const e = document.activeElement, seen = e.closest(".q-field") || e;
  const control = seen.querySelector?.(".q-field__control") ?? seen;
  const ring = [e, seen, control].some(one => {
    const style = getComputedStyle(one);
    const outlined = parseFloat(style.outlineWidth) >= 2 && style.outlineStyle !== "none";
    return outlined || style.boxShadow !== "none";
  });
  return [e.dataset.pressable ?? null, ring, e.outerHTML.slice(0, 120)];
}
"""
CUT = """
() => [...document.querySelectorAll("body *")].filter(e => {
  if (!e.checkVisibility({opacityProperty: true, visibilityProperty: true})) return false;
  const hasText = [...e.childNodes].some(node => node.nodeType === 3 && node.textContent.trim());
  const hides = !/visible|auto|scroll/.test(getComputedStyle(e).overflowX);
  return hasText && hides && !e.closest(".stage, svg") && e.clientWidth > 1 && e.scrollWidth > e.clientWidth;
}).map(e => `${e.innerText} .${e.className}`)
"""
FIRST_PICTURE = """
() => new Promise(told => {
  const look = () => [...document.images].some(one => one.complete && one.naturalWidth)
    ? requestAnimationFrame(() => told(performance.now()))  // painted by then
    : requestAnimationFrame(look);
  look();
})
"""
MOST_FIRST_PICTURE_MS = 1500.0
MOST_REPEATS = 5  # the best of them: a busy computer is not the page's fault
MOST_TABS = 150
NO_WEBGL = """
const given = HTMLCanvasElement.prototype.getContext;
HTMLCanvasElement.prototype.getContext = function (kind, ...more) {
  return kind.startsWith("webgl") ? null : given.call(this, kind, ...more);
};
"""


def low_contrast(page: Any) -> list[str]:
    """Text that stands out less than AA asks for, with its ratio; not of what is disabled."""
    return list(page.evaluate(LOW_CONTRAST, [LARGE_PX, LARGE_BOLD_PX, BOLD, AA, AA_LARGE]))


def low_contrast_by_scheme(page: Any) -> dict[str, list[str]]:
    """The same in light and dark, of those in which there is any."""
    page.add_style_tag(content="* { transition: none !important; }")  # no colour on its way to another
    found = {}
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme=scheme)
        page.wait_for_function(
            "dark => document.body.classList.contains('body--dark') === dark", arg=scheme == "dark"
        )
        found[scheme] = low_contrast(page)
    return {scheme: texts for scheme, texts in found.items() if texts}


def without_name(page: Any) -> list[str]:
    """What can be pressed or filled in and has no name for a screen reader."""
    return [html for _, name, html in page.evaluate(PRESSABLE) if not name]


def not_reached_by_tab(page: Any) -> list[str]:
    """What can be pressed and is not reached by Tab, or shows no focus then."""
    wanted = {str(number): html for number, _, html in page.evaluate(PRESSABLE)}
    faint = []
    page.evaluate("document.activeElement.blur()")
    for _ in range(MOST_TABS):
        page.keyboard.press("Tab")
        number, ring, html = page.evaluate(FOCUSED)
        if number in wanted:
            del wanted[number]
            if not ring:
                faint.append(f"no focus is seen on {html}")
        if not wanted:
            break
    return [f"not reached: {html}" for html in wanted.values()] + faint


def cut_labels(page: Any) -> list[str]:
    """Visible text that its own box cuts off, with nothing to scroll."""
    return list(page.evaluate(CUT))


def first_picture_ms(page: Any, address: str) -> float:
    """From the navigation to the first picture on the screen of another page, the best of a few."""
    best_ms = math.inf
    for _ in range(MOST_REPEATS):
        anew = page.context.new_page()
        anew.goto(address, wait_until="commit")
        best_ms = min(best_ms, float(anew.evaluate(FIRST_PICTURE)))
        anew.close()
        if best_ms < MOST_FIRST_PICTURE_MS:
            break
    return best_ms


def tops_px(page: Any, *which: str) -> list[float]:
    """Return the distance of each element from the top of the page, in CSS pixels."""
    top = "which => document.querySelector(which).getBoundingClientRect().top + window.scrollY"
    return [float(page.evaluate(top, one)) for one in which]


def too_wide(page: Any) -> int:
    """By how many pixels the page is wider than the screen."""
    return int(page.evaluate("document.documentElement.scrollWidth - window.innerWidth"))


def too_wide_by_screen(page: Any) -> dict[int, int]:
    """The same on a phone and on the least screen to work at, of those for which it is too wide."""
    found = {}
    for width, height in ((390, 844), (1280, 720)):
        page.set_viewport_size({"width": width, "height": height})
        found[width] = too_wide(page)
    return {width: by for width, by in found.items() if by > 0}
