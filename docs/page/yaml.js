// The part of YAML that robot files use: mappings, lists, flow style, anchors, comments. Anything else is an error that
// names its line.

class Reader {
  constructor(text) {
    this.lines = text
      .split(/\r?\n/)
      .map((raw, k) => ({ text: withoutComment(raw), number: k + 1 }))
      .filter((line) => line.text.trim() && !/^(---|\.\.\.|%)/.test(line.text))
      .map((line) => ({ ...line, indent: line.text.search(/\S/), text: line.text.trim() }));
    this.at = 0;
    this.anchors = new Map();
  }

  get line() {
    return this.lines[this.at];
  }

  fail(what) {
    const line = this.line ?? this.lines[this.lines.length - 1];
    throw new Error(`line ${line?.number ?? 1}: ${what}`);
  }

  block(indent) {
    return this.line.text.startsWith("- ") || this.line.text === "-" ? this.list(indent) : this.mapping(indent);
  }

  list(indent) {
    const out = [];
    while (this.line?.indent === indent && /^-(\s|$)/.test(this.line.text)) {
      const rest = this.line.text.slice(1).trimStart();
      if (!rest) {
        this.at++;
        out.push(this.line?.indent > indent ? this.block(this.line.indent) : null);
      } else if (/^[\w"']+:(\s|$)/.test(rest)) {
        // A mapping that begins on the line of its dash.
        this.line.indent += this.line.text.length - rest.length;
        this.line.text = rest;
        out.push(this.mapping(this.line.indent));
      } else {
        out.push(this.flow(rest));
        this.at++;
      }
    }
    return out;
  }

  mapping(indent) {
    const out = {};
    while (this.line?.indent === indent && !/^-(\s|$)/.test(this.line.text)) {
      const match = /^("[^"]*"|'[^']*'|[^\s:{}\[\]]+)\s*:(?:\s+(.*))?$/.exec(this.line.text);
      if (!match) this.fail(`"${this.line.text}" is no "key: value"`);
      const key = match[1].replace(/^["']|["']$/g, "");
      if (key in out) this.fail(`${key} is given twice`);
      out[key] = this.value(match[2] ?? "", indent);
    }
    if (this.line && this.line.indent > indent) this.fail("is indented too far");
    return out;
  }

  value(text, indent) {
    const named = /^&(\S+)\s*(.*)$/.exec(text);
    const own = named ? named[2] : text;
    let out;
    if (!own) {
      this.at++;
      const deeper = this.line && (this.line.indent > indent || (this.line.indent === indent && this.line.text[0] === "-"));
      out = deeper ? this.block(this.line.indent) : null;
    } else {
      out = this.flow(this.whole(own));
      this.at++;
    }
    if (named) this.anchors.set(named[1], out);
    return out;
  }

  // Flow style that goes on over lines.
  whole(text) {
    const open = (t) => [...t].reduce((n, c) => n + ("[{".includes(c) ? 1 : "]}".includes(c) ? -1 : 0), 0);
    while (/^[[{]/.test(text) && open(text) > 0 && this.at + 1 < this.lines.length) text += " " + this.lines[++this.at].text;
    return text;
  }

  flow(text) {
    const tokens = text.match(/"(?:[^"\\]|\\.)*"|'(?:[^']|'')*'|[[\]{},]|:(?=\s)|[^[\]{},:]+(?::(?!\s)[^[\]{},:]*)*/g) ?? [];
    if (!/^[[{]/.test(text)) return this.scalar(text);
    let k = 0;
    const next = () => (tokens[k] ?? this.fail("a bracket is not closed")).trim();
    const skip = () => { while (tokens[k] !== undefined && !tokens[k].trim()) k++; };
    const read = () => {
      skip();
      const token = next();
      k++;
      if (token === "[") {
        const out = [];
        for (skip(); next() !== "]"; skip()) {
          out.push(read());
          skip();
          if (next() === ",") k++;
          skip();
        }
        k++;
        return out;
      }
      if (token === "{") {
        const out = {};
        for (skip(); next() !== "}"; skip()) {
          const key = String(read());
          skip();
          if (next() !== ":") this.fail(`${key} has no value`);
          k++;
          out[key] = read();
          skip();
          if (next() === ",") k++;
          skip();
        }
        k++;
        return out;
      }
      return this.scalar(token);
    };
    return read();
  }

  scalar(text) {
    const own = text.trim();
    if (own[0] === "*") return this.anchors.has(own.slice(1)) ? this.anchors.get(own.slice(1)) : this.fail(`${own} is not defined`);
    if (/^["']/.test(own)) return own.slice(1, -1);
    if (own === "" || own === "~" || own === "null") return null;
    if (own === "true" || own === "false") return own === "true";
    return /^[-+]?(\d[\d_]*\.?\d*|\.\d+)(e[-+]?\d+)?$/i.test(own) ? Number(own.replaceAll("_", "")) : own;
  }
}

function withoutComment(line) {
  let quote = "";
  for (let k = 0; k < line.length; k++) {
    if (quote) quote = line[k] === quote ? "" : quote;
    else if (line[k] === '"' || line[k] === "'") quote = line[k];
    else if (line[k] === "#" && (k === 0 || /\s/.test(line[k - 1]))) return line.slice(0, k);
  }
  return line;
}

/** What a file says. */
export function parse(text) {
  const reader = new Reader(text);
  if (!reader.lines.length) throw new Error("the file is empty");
  const out = reader.block(reader.line.indent);
  if (reader.line) reader.fail(`"${reader.line.text}" is not understood`);
  return out;
}

const word = (value) => (typeof value === "string" && !/^[A-Za-z][\w .()+-]*$/.test(value) ? JSON.stringify(value) : String(value));

function flowText(value) {
  if (Array.isArray(value)) return `[${value.map(flowText).join(", ")}]`;
  if (value && typeof value === "object") return `{${Object.entries(value).map(([k, v]) => `${k}: ${flowText(v)}`).join(", ")}}`;
  return word(value);
}

/** A mapping as text, lists of mappings as blocks. */
export function dump(data) {
  let out = "";
  for (const [key, value] of Object.entries(data)) {
    if (Array.isArray(value) && value.some((item) => item && typeof item === "object" && !Array.isArray(item))) {
      out += `${key}:\n`;
      for (const item of value) {
        out += Object.entries(item).map(([k, v], j) => `  ${j ? " " : "-"} ${k}: ${flowText(v)}\n`).join("");
      }
    } else out += `${key}: ${flowText(value)}\n`;
  }
  return out;
}
