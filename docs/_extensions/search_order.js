// Order of what the search finds: pages whose title has words of the question come first, then
// how-to and tutorials; modules of the library and the texts of messages come last. Pages of questions are only signposts:
// their headings come first, the pages later.
const asked = new URLSearchParams(location.search).get("q") || "";
const stems = (text) => {
  const stemmer = new Stemmer();
  return new Set((text.toLowerCase().match(/[a-z]+|\d+/g) || [])
    .filter((word) => word.length > 1 && !stopwords.has(word))
    .map((word) => stemmer.stemWord(word)));
};
const KINDS = [["howto/questions", -10], ["howto/", 6], ["tutorials/", 4], ["explanation/", 3],
               ["reference/generated/tudor_dynamics", -30], ["architecture", -10],
               ["reference/generated/messages", -30]];

var Scorer = {
  score: ([docname, title, anchor, descr, score]) => {
    const words = stems(title);
    const shared = [...stems(asked)].filter((word) => words.has(word)).length;
    const kind = !anchor && KINDS.find(([start]) => docname.startsWith(start));
    return score + 8 * shared + (kind ? kind[1] : 0);
  },
  objNameMatch: 11,
  objPartialMatch: 6,
  objPrio: {0: 15, 1: 5, 2: -5},
  objPrioDefault: 0,
  title: 15,
  partialTitle: 7,
  term: 5,
  partialTerm: 2,
};

// A question in words that no page has together still has answers: pages with some of its words,
// and the rarer these are the more they count. Words that are on no page count nothing. Headings
// of guides that have most of the question in them are answers, too, and those of the pages of
// questions with less of it. First are those that have its very words, as "do not use", of which
// the index has only the last. Numbers, which are no terms of the index, count where headings have them.
const ENOUGH = 5, LEAST = 0.3, WEIGHT = 8, LEFT_OUT = 30, HEADING = 80;
const SAID = 1.5, MOST = 0.6, MOST_OF_QUESTIONS = 0.45;
const BRITISH = {licens: "licenc", center: "centr", behavior: "behaviour"};  // stems
{
  const strict = Search.performTermsSearch;
  const pages = (word) => new Set(
    [Search._index.terms, Search._index.titleterms].flatMap((terms) => Object.entries(terms))
      .filter(([term]) => term.includes(word)).flatMap(([, files]) => files)).size;
  const spoken = (text) => text.toLowerCase().replace(/[^a-z0-9]+/g, " ").trim();
  const phrase = spoken((asked.match(/"([^"]+)"/) || ["", asked])[1]);
  const says = (title) => phrase.includes(" ") && ` ${spoken(title)} `.includes(` ${phrase} `);
  const headings = (rare, most) => {
    const known = Object.entries(Search._index.alltitles).map(
      ([title, places]) => [title, places, stems(title)]);
    const wanted = new Map(rare);
    for (const number of asked.match(/\d+/g) || [])
      if (known.some(([, , words]) => words.has(number))) wanted.set(number, Math.log(most));
    const all = [...wanted.values()].reduce((sum, value) => sum + value, 0);
    return known.flatMap(([title, places, words]) => {
      const share = says(title) ? SAID : wanted.size < 2 ? 0 : [...wanted].reduce(
        (sum, [word, value]) => sum + words.has(word) * value, 0) / all;
      const {docnames, filenames, titles} = Search._index;
      return places
        .filter(([file, id]) => id && /^(howto|tutorials)/.test(docnames[file]) && share >= (
          docnames[file].startsWith("howto/questions") ? MOST_OF_QUESTIONS : MOST))
        .map(([file, id]) => [docnames[file], `${titles[file]} > ${title}`, `#${id}`, null,
                              HEADING * share, filenames[file], "title"]);
    });
  };
  Search.performTermsSearch = (words, excluded) => {
    const terms = new Set([...words].map((word) => BRITISH[word] || word));
    const whole = strict(terms, excluded);
    const most = Search._index.docnames.length;
    const rare = new Map([...terms].filter(pages).map((word) => [word, Math.log(most / pages(word))]));
    const all = [...rare.values()].reduce((sum, value) => sum + value, 0);
    const asHeadings = headings(rare, most);
    if (whole.length >= ENOUGH) return [...asHeadings, ...whole];
    const found = new Map(whole.map((item) => [item[0], {item, sum: all + LEFT_OUT / WEIGHT}]));
    const some = new Map();
    for (const [word, value] of rare)
      for (const item of strict(new Set([word]), excluded)) {
        const old = some.get(item[0]) || {item, sum: 0};
        some.set(item[0], {item: item[4] > old.item[4] ? item : old.item, sum: old.sum + value});
      }
    for (const [page, one] of some)
      if (!found.has(page) && one.sum > LEAST * all) found.set(page, one);
    return [...asHeadings, ...[...found.values()].map(
      ({item: [page, title, anchor, text, score, ...rest], sum}) =>
        [page, title, anchor, text, score + WEIGHT * sum - LEFT_OUT, ...rest])];
  };
}
