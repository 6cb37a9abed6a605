// SPDX-License-Identifier: MIT
// Search results show an excerpt of each page. Sphinx fetches the page for it, which browsers refuse to pages opened
// from a file: answer from the index of excerpts (_static/excerpts.js: page -> [[anchor, text], ...]) instead.
{
  const fetched = window.fetch;
  const escaped = (text) => text.replace(/[&<>"]/g, (letter) => `&#${letter.charCodeAt(0)};`);
  window.fetch = (address, ...rest) => {
    const path = decodeURI(new URL(address, document.baseURI).pathname);
    const page = Object.keys(window.excerpts ?? {}).find((name) => path.endsWith(`/${name}`));
    if (!page) return fetched(address, ...rest);
    const sections = window.excerpts[page].map(([anchor, text]) => `<section id="${escaped(anchor)}">${escaped(text)}</section>`);
    return Promise.resolve(new Response(`<div role="main">${sections.join("\n")}</div>`));
  };
}
