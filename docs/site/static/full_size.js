// SPDX-License-Identifier: MIT
// A picture is a link to itself in full size: wide ones cannot be read on a phone.
for (const picture of document.querySelectorAll("article img")) {
  if (picture.closest("a")) continue;
  const link = Object.assign(document.createElement("a"), { href: picture.src, title: "full size" });
  const whole = picture.closest("picture") ?? picture;
  whole.replaceWith(link);
  link.append(whole);
}
