// Stands before the site's search program (docs/search.py puts it there). It turns a typed question into words that the index can
// find: without "how do I", and each word as its stem, "simul" of "simulations". What has a quote or an operator stays as it is.
const NO_CONTENT = new Set(
  ("a about all also am an and any anything are as at be been but by can cannot could did do does doing each for from get gets "
    + "give go had has have having he her here his how i if in into is it its just let like make me mean means more most much "
    + "my need needs no not of on one or our out own please possible put say see shall she should so some something such "
    + "take takes than that the their them then there these they this those to up us use used uses using very via want "
    + "wants was way we were what when where which while who whose why will with without two three several other each only difference between work works would yes you your").split(" ")
);
const ASKS_MEANING = /^\s*(what('s| is| are| does| do)\b|define|definition|meaning)|\bmean(s|ing)?\W*$|\bmeaning of\b|difference between/i;
const BEGINNING = 5; // Letters of the last word, which may not be whole yet: the index holds stems, "simul" of "simulatio".

function stem(word) {
  return self.lunr.stemmer(new self.lunr.Token(word, {})).toString();
}

function inWords(query) {
  if (/["+~^:*]/.test(query)) return query;
  const words = query.toLowerCase().split(/[^\p{L}\p{N}_]+/u).filter(word => word.length > 1);
  const kept = words.filter(word => !NO_CONTENT.has(word));
  const asked = kept.length ? kept : words;
  if (!asked.length) return query;
  const whole = asked.map(word => `${stem(word)}^10`);
  if (ASKS_MEANING.test(query)) whole.push(`${stem("meaningofaword")}^30`);
  return [...whole, asked.at(-1).slice(0, BEGINNING)].join(" ");
}

addEventListener("message", event => {
  if (event.data.type !== 2 || event.data.isInWords) return; // 2: a query
  event.stopImmediatePropagation();
  dispatchEvent(new MessageEvent("message", { data: { type: 2, data: inWords(event.data.data), isInWords: true } }));
});
