#!/usr/bin/env python3
"""Holds the limits that make this repository's text readable.

Lines of code, comments and prose have at most 120 columns. A sentence has at most 40 words, and the sentences of a
Markdown page, or of all comments of a crate, have fewer than 20 words on average.

On the pages of `PLAIN`, no sentence begins with a word of `OPENERS`, which stands for a noun or inverts the word order.
Questions and the beginnings in `ALLOWED_OPENINGS` are exempt.

All rows of a table in Markdown have as many cells as its head.

Not counted: tables, fences of code, headings, targets of links, HTML and snapshots of tests. A span in backticks is one
word. A list item is a sentence of its own, and so is what stands before a list or a fence.

    .ci/prose.py                    every file that git tracks
    .ci/prose.py docs src/main.rs   only these
    .ci/prose.py --summary          mean and longest sentence of each file, too
    .ci/prose.py --self-test        tries the rules on examples
"""

import argparse
import bisect
import io
import os
import re
import subprocess
import sys
import tokenize
from collections import defaultdict

COLUMNS = 120
LONGEST = 40
MEAN = 20
SUFFIXES = (".rs", ".md", ".yaml", ".py", ".sh", ".toml")
# Generated, or quoted by tests to the byte.
EXEMPT = re.compile(r"(^|/)(snapshots|target)/|\.snap$|(^|/)Cargo\.lock$")

# Pages in plain word order, and the words that none of their sentences begins with.
PLAIN = re.compile(
    r"^(README|CHANGELOG|CONTRIBUTING|pipelines/README|benches/.*"
    r"|docs/(ARCHITECTURE|action_record|adding_a_kind|many_machines|pipelines|security|stress|using|words)"
    r"|docs/(benchmarks|formats|study)/.*"
    r"|nodes/.*/src/.*)\.md$"
)
OPENERS = {"what", "that", "of", "with", "so", "beside", "there"}
ALLOWED_OPENINGS = ("So far,",)

# A point after one of these ends no sentence, unless a capital follows one of the second row.
ABBREVIATIONS = {"e.g", "i.e", "cf", "vs", "fig", "eq", "sec", "no", "approx", "resp", "dr", "p", "pp", "ca"}
OPEN_ABBREVIATIONS = {"spp", "etc", "al"}

FENCE = re.compile(r"^\s*(```|~~~)")
TABLE = re.compile(r"^\s*\|")
HEADING = re.compile(r"^\s*(#{1,6}\s|=+\s*$|-{3,}\s*$|\*{3,}\s*$)")
ITEM = re.compile(r"^\s*([-*+]|\d+[.)])\s+")
DEFINITION = re.compile(r"^\s*\[[^\]]+\]:\s")
QUOTE = re.compile(r"^\s*>\s?")
END = re.compile(r"[.!?][)\]\"'”’*_]*(?=\s|$)")
WORD = re.compile(r"[^\W_]")
COMMENT_LEADER = re.compile(r"^\s*(//[/!]?|#+|[-*+]|\d+[.)])?\s*")
ONE_LINK = re.compile(r"^!?\[.*\]\([^)]*\)[.,;:]?$|^\[[^\]]+\]:\s*\S+$")


# Prose: pieces of text with the line each begins on.


def paragraphs(lines):
    """Splits Markdown into paragraphs, each a list of (line number, text); `lines` are such pairs."""
    found, current, fenced, comment = [], [], False, False

    def close():
        nonlocal current
        if current:
            found.append(current)
        current = []

    for number, line in lines:
        if FENCE.match(line):
            fenced = not fenced
            close()
            continue
        if fenced:
            continue
        if comment or line.lstrip().startswith("<!--"):
            comment = "-->" not in line
            close()
            continue
        line = QUOTE.sub("", line)
        if not line.strip() or TABLE.match(line) or HEADING.match(line) or DEFINITION.match(line):
            close()
            continue
        item = ITEM.match(line)
        if item:
            close()
            line = " " * item.end() + line[item.end():]
        current.append((number, line))
    close()
    return found


def blank(match):
    return " " * len(match.group())


def plain(text):
    """Text of a paragraph without marks; as long as it was, so that positions stay."""
    text = re.sub(r"(`+)(.+?)\1", lambda m: "c" * len(m.group()), text, flags=re.S)
    text = re.sub(r"\$[^$\n]+\$", lambda m: "c" * len(m.group()), text)
    text = re.sub(r"!\[[^\]]*\]\([^)]*\)", blank, text)
    text = re.sub(r"\]\([^)]*\)", blank, text)
    text = re.sub(r"\]\[[^\]]*\]", blank, text)
    text = re.sub(r"<!--.*?-->", blank, text, flags=re.S)
    return re.sub(r"</?[a-zA-Z][^<>]*>", blank, text)


def ends(text):
    """Positions after which a sentence is over."""
    for match in END.finditer(text):
        if match.group()[0] == ".":
            before = re.search(r"([\w.]+)$", text[:match.start()])
            word = before.group(1).lower() if before else ""
            rest = text[match.end():].lstrip()
            if word in ABBREVIATIONS or (word in OPEN_ABBREVIATIONS and rest and not rest[0].isupper()):
                continue
        yield match.end()


def sentences(lines):
    """Sentences of Markdown as (line number, number of words, text)."""
    for paragraph in paragraphs(lines):
        starts, joined = [], ""
        for _, text in paragraph:
            starts.append(len(joined))
            joined += text + "\n"
        text, begin = plain(joined), 0
        for end in [*ends(text), len(text)]:
            piece = text[begin:end]
            words = [word for word in piece.split() if WORD.search(word)]
            if words:
                first = begin + len(piece) - len(piece.lstrip())
                number = paragraph[bisect.bisect_right(starts, first) - 1][0]
                yield number, len(words), " ".join(joined[begin:end].split())
            begin = end


def opener(text):
    """The word of `OPENERS` that a sentence begins with, or None."""
    bare = text.lstrip("*_([\"'“‘ ")
    first = re.match(r"[A-Za-z]+", bare)
    if not first or first.group().lower() not in OPENERS:
        return None
    if text.rstrip("*_)\"'”’ ").endswith("?") or bare.startswith(ALLOWED_OPENINGS):
        return None
    return first.group()


# Comments of programs, as blocks of lines that belong together.


def blocks(comments):
    """Joins comments of neighbouring lines; `comments` are (line, column, mark, text, alone on its line)."""
    found, last = [], None
    for number, column, mark, text, alone in comments:
        follows = last is not None and alone and last == (number - 1, column, mark)
        if follows:
            found[-1].append((number, text))
        else:
            found.append([(number, text)])
        last = (number, column, mark) if alone else None
    return found


RUST = re.compile(
    r"""(?P<raw>\b[bc]?r(?P<hashes>\#*)".*?"(?P=hashes))"""
    r"""|(?P<string>"(?:\\.|[^"\\])*")"""
    r"""|(?P<char>'(?:\\(?:u\{[^}]*\}|x..|.)|[^'\\\n])')"""
    r"""|(?P<line>//[/!]?[^\n]*)"""
    r"""|(?P<block>/\*.*?\*/)""",
    re.S,
)


def rust_comments(source):
    starts = [0, *(match.end() for match in re.finditer("\n", source))]
    for match in RUST.finditer(source):
        row = bisect.bisect_right(starts, match.start()) - 1
        column = match.start() - starts[row]
        alone = not source[starts[row]:match.start()].strip()
        if match.lastgroup == "line":
            mark = re.match(r"///(?!/)|//!|//", match.group()).group()
            yield row + 1, column, mark, match.group()[len(mark):].removeprefix(" "), alone
        elif match.lastgroup == "block":
            for offset, text in enumerate(match.group()[2:-2].split("\n")):
                yield row + 1 + offset, column, "/*", text.strip().removeprefix("* "), alone


def python_comments(source):
    lines = source.split("\n")
    try:
        for token in tokenize.generate_tokens(io.StringIO(source).readline):
            row, column = token.start
            if token.type == tokenize.COMMENT and not token.string.startswith("#!"):
                alone = not lines[row - 1][:column].strip()
                yield row, column, "#", token.string.lstrip("#").removeprefix(" "), alone
    except (tokenize.TokenError, SyntaxError):
        return


YAML = re.compile(r"""(?P<string>(?<!\w)(?:"(?:\\.|[^"\\])*"|'[^']*'))|(?P<line>(?:^|(?<=\s))#.*)""")


def yaml_comments(source):
    for number, line in enumerate(source.split("\n"), 1):
        for match in YAML.finditer(line):
            if match.lastgroup == "line":
                alone = not line[:match.start()].strip()
                yield number, match.start(), "#", match.group().lstrip("#").removeprefix(" "), alone


COMMENTS = {".rs": rust_comments, ".py": python_comments, ".yaml": yaml_comments}


def prose(path, source):
    """Sentences of a file."""
    suffix = os.path.splitext(path)[1]
    if suffix == ".md":
        return list(sentences(list(enumerate(source.split("\n"), 1))))
    if suffix in COMMENTS:
        return [sentence for block in blocks(COMMENTS[suffix](source)) for sentence in sentences(block)]
    return []


# Lines.


def long_lines(path, source):
    """Lines beyond the limit that could be shorter, as (line number, columns)."""
    markdown, fenced = path.endswith(".md"), False
    for number, line in enumerate(source.split("\n"), 1):
        if markdown and FENCE.match(line):
            fenced = not fenced
        if len(line) <= COLUMNS or fenced:
            continue
        content = line[COMMENT_LEADER.match(line).end():].strip()
        table = content.startswith("|") and (markdown or line.lstrip().startswith(("//", "#")))
        one = not re.search(r"\s", content) and "://" in content
        if not (table or one or ONE_LINK.match(content)):
            yield number, len(line)


# Tables.


def cells(line):
    """Number of cells of a row. Bars within code count unless they are escaped, as on GitHub."""
    row = re.sub(r"^\||(?<!\\)\|$", "", line.strip())
    return len(re.findall(r"(?<!\\)\|", row)) + 1


def ragged_rows(source):
    """Rows of tables that have more or fewer cells than the head, as (line number, cells, cells of the head)."""
    wanted, fenced = None, False
    for number, line in enumerate(source.split("\n"), 1):
        if FENCE.match(line):
            fenced = not fenced
        if fenced or not TABLE.match(line):
            wanted = None
            continue
        found = cells(line)
        if wanted is None:
            wanted = found
        elif found != wanted:
            yield number, found, wanted


# The whole.


def tracked(paths):
    command = ["git", "ls-files", "-z", "--cached"]
    if paths:
        command += ["--others", "--exclude-standard"]
    names = subprocess.run([*command, "--", *paths], check=True, capture_output=True, text=True).stdout.split("\0")
    chosen = {name for name in names if name.endswith(SUFFIXES) and not EXEMPT.search(name) and os.path.isfile(name)}
    return sorted(chosen)


def crate(path):
    """The folder of the package that a Rust file belongs to."""
    folder = os.path.dirname(path)
    while folder and not os.path.exists(os.path.join(folder, "Cargo.toml")):
        folder = os.path.dirname(folder)
    return folder or "."


def check(files):
    """Messages of all violations, and the sentences' lengths by file."""
    messages, lengths, groups = [], {}, defaultdict(list)
    for path in files:
        with open(path, encoding="utf-8") as file:
            source = file.read()
        for number, columns in long_lines(path, source):
            messages.append((path, number, f"{columns} columns, at most {COLUMNS}"))
        if path.endswith(".md"):
            for number, has, wanted in ragged_rows(source):
                messages.append((path, number, f"a row of {has} cells in a table of {wanted}"))
        found = prose(path, source)
        lengths[path] = [words for _, words, _ in found]
        for number, words, text in found:
            if words > LONGEST:
                shown = text if len(text) < 70 else text[:67] + "..."
                messages.append((path, number, f"a sentence of {words} words, at most {LONGEST}: {shown}"))
            if PLAIN.match(path) and opener(text):
                shown = text if len(text) < 70 else text[:67] + "..."
                messages.append((path, number, f"a sentence that begins with {opener(text)}: {shown}"))
        if path.endswith(".md"):
            groups[path] += lengths[path]
        elif path.endswith(".rs"):
            groups[f"{crate(path)} (comments)"] += lengths[path]
    for group, all_lengths in sorted(groups.items()):
        if all_lengths and sum(all_lengths) / len(all_lengths) >= MEAN:
            mean = sum(all_lengths) / len(all_lengths)
            messages.append((group, 0, f"{mean:.1f} words a sentence on average, fewer than {MEAN} wanted"))
    return messages, lengths, groups


def row(name, lengths):
    mean = sum(lengths) / len(lengths)
    return f"{mean:6.1f} mean {max(lengths):4} longest {len(lengths):6} sentences  {name}"


# Examples that hold the rules themselves.


def self_test():
    def counts(text, path="a.md"):
        return [words for _, words, _ in prose(path, text)]

    expect = [
        (counts("One two. Three four five! Six; seven eight?"), [2, 3, 3]),
        (counts("At 3.5 times e.g. this one. And i.e. that."), [6, 3]),
        (counts("It has 32 spp. The next has 4 spp. on each side."), [4, 8]),
        (counts("A `span of code. With a point` is one."), [4]),
        (counts("See [the page](https://a.b/c. d e f)."), [3]),
        (counts("Begin:\n\n```sh\nmany words. in code\n```\n- one item\n- two more words\n  and on"), [1, 2, 5]),
        (counts("| a | table |\n|---|---|\n\n# A heading of words\n\nText <b class='x y'>here</b>."), [2]),
        (counts("Words <!-- hidden words --> shown.\n<!-- a\nb -->\nAfter."), [2, 1]),
        (counts("1. First item\n2. Second item here"), [2, 3]),
        (counts("//! Head of two\n//! lines.\nlet a = \"// no comment\"; // a tail\n", "a.rs"), [4, 2]),
        (counts("let c = '\"'; // one two\nlet r = r#\"a \" // b\"#;\n/* three four five */\n", "a.rs"), [2, 3]),
        (counts("fn f<'a>(x: &'a str) {} // one two three\n", "a.rs"), [3]),
        (counts("/// Doc.\n// Plain words.\n", "a.rs"), [1, 2]),
        (counts("# Head words\n# go on.\na: 'x # y' # tail\nb: c#d\n", "a.yaml"), [4, 1]),
        (counts("#!/bin/python\nx = '# no'  # yes it is\n# More.\n", "a.py"), [3, 1]),
        ([n for n, _, _ in prose("a.md", "\n\nOne\ntwo. Three\nfour.")], [3, 4]),
        (list(long_lines("a.rs", "x" * 121 + "\n" + "y" * 120)), [(1, 121)]),
        (list(long_lines("a.md", "| " + "x " * 80 + "|\n```\n" + "y " * 80 + "\n```\n" + "z " * 61)), [(5, 122)]),
        (list(long_lines("a.md", "- [text](https://" + "x" * 120 + ").")), []),
        (list(long_lines("a.rs", "    // https://" + "x" * 120)), []),
        (list(ragged_rows("| a | b |\n|---|---|\n| `x \\| y` | 1 |\n| | |\n| 1 |")), [(5, 1, 2)]),
        (list(ragged_rows("| a | b |\n|---|---|\n|1||\n||2|")), []),
        (list(ragged_rows("| a |\n|---|\n| 1 | 2 |\n\n| b | c |\n|---|---|\n| 3 | 4 |")), [(3, 2, 1)]),
        (list(ragged_rows("```\n| a | b |\n| 1 |\n```")), []),
    ]
    def openers(text):
        return [opener(sentence) for _, _, sentence in prose("a.md", text)]

    expect += [
        (openers("What runs goes on. That is it. The rest ends."), ["What", "That", None]),
        (openers("**So it is.** *With `a` it is.* (Of these, two.)"), ["So", "With", "Of"]),
        (openers("What does it cost? **Of what is it?** Nothing."), [None, None, None]),
        (openers("- Beside it.\n- Something there.\n- `so` is code."), ["Beside", None, None]),
        (openers("Therefore. Whatever. Office."), [None, None, None]),
        (openers("So far, nothing failed. There is more."), [None, "There"]),
    ]
    bad = [f"example {i}: {found} for {wanted}" for i, (found, wanted) in enumerate(expect) if found != wanted]
    print("\n".join(bad) if bad else f"{len(expect)} examples hold")
    return 1 if bad else 0


def main():
    arguments = argparse.ArgumentParser(description="Limits of lines and sentences.")
    arguments.add_argument("paths", nargs="*", help="files or folders; all that git tracks if none is given")
    arguments.add_argument("--summary", action="store_true", help="mean and longest sentence of each file")
    arguments.add_argument("--self-test", action="store_true", help="try the rules on examples")
    given = arguments.parse_args()
    if given.self_test:
        return self_test()
    files = tracked(given.paths)
    messages, lengths, groups = check(files)
    if given.summary:
        for path, found in lengths.items():
            if found:
                print(row(path, found))
        for group, found in sorted(groups.items()):
            if found and not group.endswith(".md"):
                print(row(group, found))
    for path, number, message in sorted(messages):
        print(f"{path}:{number}: {message}" if number else f"{path}: {message}")
    print(f"prose: {len(messages)} violations in {len({path for path, _, _ in messages})} of {len(files)} files")
    return 1 if messages else 0


if __name__ == "__main__":
    sys.exit(main())
