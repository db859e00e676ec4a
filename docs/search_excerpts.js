// Adds an excerpt to each hit on the search page: the part of the hit's section with most of the searched words.
// SEARCH_TEXTS has, for each page, the anchors and the text of each section.

const EXCERPT_LENGTH = 240;
const CONTEXT_LENGTH = 60;

// Return a pattern for words that begin with the stem of a searched word, as in Sphinx's index, or null if it has no words.
const searchPattern = (query) => {
  const stemmer = new Stemmer();
  const words = (query.toLowerCase().match(/[\p{Letter}\p{Number}_]+/gu) || []).filter(
    (word) => ![...stopwords].includes(word),
  );
  const stems = words.map((word) => stemmer.stemWord(word));
  // The longer alternative first, so that a whole word is marked.
  const alternatives = [...new Set([...words, ...stems])].sort((a, b) => b.length - a.length);
  if (!alternatives.length) return null;
  return new RegExp(`(?<![\\p{Letter}\\p{Number}])(?:${alternatives.join("|")})[\\p{Letter}\\p{Number}]*`, "giu");
};

// Return the text of a hit's section. Anchors of index entries and of Python objects are those of no section.
const hitText = (link) => {
  const [path, anchor] = link.getAttribute("href").split("#");
  const page = path.split("?")[0].replace(/\.html$/, "");
  const sections = SEARCH_TEXTS[page] || [];
  const section = anchor && sections.find(([anchors]) => anchors.includes(decodeURIComponent(anchor)));
  return section && section[1] ? section[1] : sections.map(([, text]) => text).join(" ");
};

// Return the begin of the excerpt: that of the first match whose surroundings have most of the different words.
const excerptBegin = (text, pattern) => {
  const stemmer = new Stemmer();
  const matches = [...text.matchAll(pattern)];
  let best = { count: 0, begin: 0 };
  matches.forEach((match, number) => {
    const near = matches.slice(number).filter((other) => other.index < match.index + EXCERPT_LENGTH - CONTEXT_LENGTH);
    const count = new Set(near.map((other) => stemmer.stemWord(other[0].toLowerCase()))).size;
    if (count > best.count) best = { count, begin: match.index };
  });
  return best.begin <= CONTEXT_LENGTH ? 0 : text.indexOf(" ", best.begin - CONTEXT_LENGTH) + 1;
};

// Return a paragraph with the excerpt, in which the searched words are marked.
const makeExcerpt = (text, pattern) => {
  const begin = excerptBegin(text, pattern);
  let end = text.length;
  if (end > begin + EXCERPT_LENGTH) end = Math.max(text.lastIndexOf(" ", begin + EXCERPT_LENGTH), begin + CONTEXT_LENGTH);
  const excerpt = text.slice(begin, end);
  const paragraph = document.createElement("p");
  paragraph.className = "context";
  let position = 0;
  paragraph.append(begin ? "… " : "");
  for (const match of excerpt.matchAll(pattern)) {
    const mark = document.createElement("mark");
    mark.textContent = match[0];
    paragraph.append(excerpt.slice(position, match.index), mark);
    position = match.index + match[0].length;
  }
  paragraph.append(excerpt.slice(position), end < text.length ? " …" : "");
  return paragraph;
};

const addExcerpts = () => {
  const results = document.getElementById("search-results");
  const pattern = searchPattern(new URLSearchParams(location.search).get("q") || "");
  if (!results || !pattern) return;
  const addMissing = () => {
    for (const link of results.querySelectorAll("ul.search > li > a")) {
      const hasExcerpt = link.parentElement.querySelector("p.context") !== null;
      const text = hasExcerpt ? "" : hitText(link);
      if (text) link.parentElement.append(makeExcerpt(text, pattern));
    }
  };
  // Sphinx adds the hits one after the other.
  new MutationObserver(addMissing).observe(results, { childList: true, subtree: true });
  addMissing();
};

if (document.readyState === "loading") document.addEventListener("DOMContentLoaded", addExcerpts);
else addExcerpts();
