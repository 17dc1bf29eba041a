// What the words mean: the page of the book, which is the one source, read once when it is first wanted.
import { ask } from './api.js';
import { REPORT } from './carried.js';

const SOURCE = '/docs/book/reference/glossary.md';

/** The name of a heading as the book makes it; codes such as `at_bound` have the name of their words. */
const anchor = text =>
  text
    .trim()
    .toLowerCase()
    .replaceAll(/[^\p{L}\p{N}\s-]/gu, '')
    .replaceAll(/\s/g, '-');

const plain = text =>
  text
    .replaceAll(/\[([^\]]*)\]\([^)]*\)/g, '$1')
    .replaceAll('`', '')
    .replaceAll(/\s+/g, ' ')
    .trim();

/** Below each heading of the third order stands a paragraph with the meaning. */
function entriesOf(text) {
  const entries = text.split(/^### /m).slice(1);
  return new Map(entries.map(entry => entry.split(/\n\s*\n/)).map(([term, meaning]) => [term.trim(), plain(meaning)]));
}

let reading = null;

/** All terms with their meanings; none where the book cannot be read, and then it is asked again the next time. */
export const glossary = () =>
  (reading ??= ask(SOURCE, { accept: 'text/plain' }).then(entriesOf, () => {
    reading = null;
    return new Map();
  }));

/** Where the book says it; a report has no book. */
export const inTheBook = term => (REPORT ? null : `/docs/book/reference/glossary.html#${anchor(term)}`);
