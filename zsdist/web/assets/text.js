// Texts and elements. Everything that a run says is shown as text, never as HTML.

export function element(name, attributes = {}, ...children) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.append(...children);
  return made;
}

export function setText(node, text) {
  if (node.textContent !== text) node.textContent = text;
}

export function number(value) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "-";
  if (Number.isInteger(value)) return value.toLocaleString("en");
  const size = Math.abs(value);
  if (size !== 0 && (size < 0.001 || size >= 1e7)) return value.toExponential(2);
  return size >= 100 ? value.toFixed(0) : size >= 1 ? value.toFixed(2) : value.toFixed(4);
}

export function words(name) {
  return name.replaceAll("_", " ");
}

// Shows pairs of term and text in a <dl>, and changes only what is new.
export function showPairs(list, pairs) {
  while (list.children.length > pairs.length) list.lastChild.remove();
  pairs.forEach(([term, text], index) => {
    if (!list.children[index]) list.append(element("div", {}, element("dt"), element("dd")));
    const [dt, dd] = list.children[index].children;
    setText(dt, term);
    setText(dd, String(text));
  });
}
