// Tables that are wider than their place are marked, so that a phone says that they scroll.
const mark = () => {
  for (const place of document.querySelectorAll(".table-wrapper"))
    place.classList.toggle("wide", place.scrollWidth > place.clientWidth + 1);
};
addEventListener("load", mark);
addEventListener("resize", mark);
