// Long names break after a dot, a slash or an underscore, and options never at their hyphens.
// What ends a sentence stays with the formula before it.
const NAMES = "table code, h1, .sig .pre, .names a";
const OPTION = /(?<![^\s("'`])--?[A-Za-z][\w-]*/;

function textsOf(element) {
  const walker = document.createTreeWalker(element, NodeFilter.SHOW_TEXT);
  const texts = [];
  while (walker.nextNode()) texts.push(walker.currentNode);
  return texts;
}

function breakName(text) {
  const parts = text.data.split(/(?<=\w{3}\.(?!\w{2,5}$)|\w[/_]|[=:;,]|\w[[(])(?=[A-Za-z_'"\d])/);
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
    span.className = "one-line";
    option.replaceWith(span);
    span.append(option);
  }
}

function keepMark(formula) {
  const after = formula.nextSibling;
  const mark = after && after.nodeType === Node.TEXT_NODE && /^[,.;:)]+/.exec(after.data);
  if (!mark) return;
  after.splitText(mark[0].length);
  const span = document.createElement("span");
  span.className = "one-line";
  formula.replaceWith(span);
  span.append(formula, after);
}

document.addEventListener("DOMContentLoaded", () => {
  const content = document.querySelector(".content");
  if (!content) return;
  for (const name of content.querySelectorAll(NAMES)) textsOf(name).forEach(breakName);
  for (const code of content.querySelectorAll(".highlight-sh pre, code .pre"))
    textsOf(code).forEach(keepOptions);
  content.querySelectorAll("span.math").forEach(keepMark);
});
