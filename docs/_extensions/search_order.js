// Order of what the search finds: pages whose title has words of the question come first, then
// how-to and tutorials; modules of the library come last.
const asked = new URLSearchParams(location.search).get("q") || "";
const stems = (text) => {
  const stemmer = new Stemmer();
  return new Set((text.toLowerCase().match(/[a-z]+/g) || [])
    .filter((word) => word.length > 1 && !stopwords.has(word))
    .map((word) => stemmer.stemWord(word)));
};
const KINDS = [["howto/", 6], ["tutorials/", 4], ["explanation/", 3],
               ["reference/generated/tudor_dynamics", -30], ["architecture", -10]];

var Scorer = {
  score: ([docname, title, anchor, descr, score]) => {
    const words = stems(title);
    const shared = [...stems(asked)].filter((word) => words.has(word)).length;
    const kind = KINDS.find(([start]) => docname.startsWith(start));
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

// A question in words that no page has together still has answers: the rarest word is left out
// until there are some; what has fewer of the words comes after what has more.
const ENOUGH = 5, LEFT_OUT = 30;
{
  const strict = Search.performTermsSearch;
  const pages = (word) => new Set(Object.entries(Search._index.terms)
    .filter(([term]) => term.includes(word)).flatMap(([, files]) => files)).size;
  Search.performTermsSearch = (terms, excluded) => {
    const words = [...terms].sort((one, other) => pages(other) - pages(one));
    const found = new Map();
    for (let less = 0; words.length && found.size < ENOUGH; words.pop(), less += LEFT_OUT)
      for (const [name, title, anchor, text, score, ...rest] of strict(new Set(words), excluded))
        if (!found.has(name)) found.set(name, [name, title, anchor, text, score - less, ...rest]);
    return [...found.values()];
  };
}
