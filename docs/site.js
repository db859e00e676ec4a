// Sphinx marks the words of the last search in a page, and stops at a word in the title of an icon of the theme.
document.addEventListener("DOMContentLoaded", () => {
  for (const title of document.querySelectorAll("svg title")) title.classList.add("nohighlight");
});
