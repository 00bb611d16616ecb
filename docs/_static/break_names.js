// Long names break after a dot, a slash or an underscore, and options never at their hyphens.
const NAMES = "table code, h1, .sig .pre, .names a";
const OPTION = /(?<![^\s("'`])--?[A-Za-z][\w-]*/;

function textsOf(element) {
  const walker = document.createTreeWalker(element, NodeFilter.SHOW_TEXT);
  const texts = [];
  while (walker.nextNode()) texts.push(walker.currentNode);
  return texts;
}

function breakName(text) {
  const parts = text.data.split(/(?<=\w{3}\.|[/_=[(:;,])(?=[A-Za-z_'"\d])(?!\w{2,5}$)/);
  if (parts.length === 1) return;
  text.replaceWith(...parts.flatMap((part) => {
    const place = document.createElement("wbr");
    place.className = "name-break";
    return [place, part];
  }).slice(1));
}

function keepOptions(text) {
  for (let match; (match = OPTION.exec(text.data));) {
    const option = text.splitText(match.index);
    text = option.splitText(match[0].length);
    const span = document.createElement("span");
    span.className = "option-name";
    option.replaceWith(span);
    span.append(option);
  }
}

document.addEventListener("DOMContentLoaded", () => {
  const content = document.querySelector(".content");
  if (!content) return;
  for (const name of content.querySelectorAll(NAMES)) textsOf(name).forEach(breakName);
  for (const code of content.querySelectorAll(".highlight-sh pre, code .pre"))
    textsOf(code).forEach(keepOptions);
});
