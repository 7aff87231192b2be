"""Whether a page fits its window."""

OVERFLOW = """() => [...document.querySelectorAll('body *')].filter(e => {
  const box = e.getBoundingClientRect();
  return box.width > 0 && !e.closest('thead') && box.right > document.documentElement.clientWidth + 1;
}).map(e => e.tagName + '.' + e.className + ': ' + (e.innerText || e.alt || '').slice(0, 60)).slice(0, 5)"""
"""What of a page reaches beyond its right edge, at most five of it."""
