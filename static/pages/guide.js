// The guide: marks the section that is being read.

const links = new Map([...document.querySelectorAll(".guide-sections a")].map((a) => [a.hash.slice(1), a]));

if (window.matchMedia("(max-width: 560px)").matches) document.querySelector(".guide-menu").open = false; // the text first

function mark(anchor) {
  for (const [name, link] of links) {
    if (name === anchor) link.setAttribute("aria-current", "true");
    else link.removeAttribute("aria-current");
  }
}

const seen = new IntersectionObserver(
  (entries) => {
    const top = entries.filter((e) => e.isIntersecting).sort((a, b) => a.boundingClientRect.top - b.boundingClientRect.top)[0];
    if (top) mark(top.target.id);
  },
  { rootMargin: "-48px 0px -70% 0px" },
);
for (const heading of document.querySelectorAll(".guide-text h2, .guide-text h3")) seen.observe(heading);
document.documentElement.dataset.ready = "guide";
