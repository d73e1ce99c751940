//! Arrows between the rooms of a module folder: ARCHITECTURE.md lists them, the source has those and no others.
//!
//! A list is a block of text that begins with `rooms of FOLDER`. Each line names rooms, and behind `→` the rooms that they
//! may name something of. Those stand in lines above, so a list without a circle is the only one that can be written.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use proc_macro2::{Delimiter, TokenStream, TokenTree};

use super::{files_below, text_of};

/// Words that begin a list.
const HEAD: &str = "rooms of ";

type Module = Vec<String>;

/// The rooms of one folder as the document has them.
#[derive(Default)]
struct List {
    folder: String,
    rooms: Vec<String>,
    /// From, to.
    arrows: BTreeSet<(String, String)>,
    /// Faults of the list itself.
    faults: Vec<String>,
}

fn lists(document: &str) -> Vec<List> {
    let mut lists: Vec<List> = Vec::new();
    let mut is_open = false;
    for line in document.lines() {
        if let Some(folder) = line.strip_prefix(HEAD) {
            lists.push(List { folder: folder.to_owned(), ..List::default() });
            is_open = true;
        } else if line.starts_with("```") {
            is_open = false;
        } else if let Some(list) = lists.last_mut().filter(|_| is_open) {
            list.add(line);
        }
    }
    lists
}

impl List {
    /// Reads a line: `a, b → c, d`.
    fn add(&mut self, line: &str) {
        let words = |text: &str| -> Vec<String> {
            text.split(',').map(|word| word.trim().to_owned()).filter(|word| !word.is_empty()).collect()
        };
        let (from, to) = line.split_once('→').unwrap_or((line, ""));
        let (from, to) = (words(from), words(to));
        for room in to.iter().filter(|room| !self.rooms.contains(room)) {
            self.faults.push(format!("{line}: '{room}' does not stand above"));
        }
        for (a, b) in from.iter().flat_map(|a| to.iter().map(move |b| (a, b))) {
            self.arrows.insert((a.clone(), b.clone()));
        }
        self.rooms.extend(from);
    }

    /// Compares the list with the rooms and arrows of the source; each arrow comes with a file that has it.
    fn faults(mut self, rooms: &BTreeSet<String>, found: &BTreeMap<(String, String), String>) -> Vec<String> {
        let listed: BTreeSet<String> = self.rooms.iter().cloned().collect();
        let mut faults = std::mem::take(&mut self.faults);
        faults.extend(rooms.difference(&listed).map(|room| format!("room '{room}' is not listed")));
        faults.extend(listed.difference(rooms).map(|room| format!("there is no room '{room}'")));
        for ((from, to), file) in found.iter().filter(|(arrow, _)| !self.arrows.contains(arrow)) {
            faults.push(format!("{from} → {to} is not listed; {file} has it"));
        }
        for (from, to) in self.arrows.iter().filter(|arrow| !found.contains_key(arrow)) {
            faults.push(format!("{from} → {to} is listed, and no file has it"));
        }
        faults.into_iter().map(|fault| format!("{}: {fault}", self.folder)).collect()
    }
}

/// An item that a file names, and the name that it has there.
#[derive(Debug, PartialEq, Eq)]
struct Named {
    path: Module,
    name: String,
}

/// Items of its own crate that the code of a module names, tests left out.
fn named_by(code: &str, module: &Module) -> Vec<Named> {
    let tokens: TokenStream = code.parse().expect("the source is Rust");
    let mut found = Vec::new();
    walk(&tokens.into_iter().collect::<Vec<_>>(), module, &mut found);
    found
}

fn walk(tokens: &[TokenTree], module: &Module, found: &mut Vec<Named>) {
    let mut at = 0;
    while at < tokens.len() {
        match &tokens[at] {
            TokenTree::Punct(punct) if punct.as_char() == '#' && is_cfg_test(tokens.get(at + 1)) => {
                at += tokens[at..].iter().position(is_end_of_item).unwrap_or(tokens.len());
            }
            TokenTree::Ident(word) if word == "mod" => {
                if let [TokenTree::Ident(name), TokenTree::Group(body), ..] = &tokens[at + 1..] {
                    let inner: Module = module.iter().cloned().chain([name.to_string()]).collect();
                    walk(&body.stream().into_iter().collect::<Vec<_>>(), &inner, found);
                    at += 2;
                }
            }
            TokenTree::Ident(word) if word == "use" && root_of(&tokens[at + 1..], module).is_none() => {
                tree(&tokens[at + 1..], module.clone(), found);
            }
            TokenTree::Ident(_) => {
                if let Some((base, length)) = root_of(&tokens[at..], module) {
                    at += length;
                    tree(&tokens[at..], base, found);
                    continue;
                }
            }
            TokenTree::Group(group) => walk(&group.stream().into_iter().collect::<Vec<_>>(), module, found),
            _ => (),
        }
        at += 1;
    }
}

/// The module that a path begins at, and the length of its words `crate`, `self` and `super`; none for other paths.
fn root_of(tokens: &[TokenTree], module: &Module) -> Option<(Module, usize)> {
    let mut root = None;
    let mut at = 0;
    while is_path(&tokens[at..]) {
        let mut base = root.clone().unwrap_or_else(|| module.clone());
        match tokens[at].to_string().as_str() {
            "crate" => base.clear(),
            "super" => drop(base.pop()),
            "self" => (),
            _ => break,
        }
        root = Some(base);
        at += 3;
    }
    root.map(|base| (base, at))
}

/// Reads the rest of a path, or of a tree of them, behind `base`.
fn tree(tokens: &[TokenTree], mut base: Module, found: &mut Vec<Named>) {
    match tokens.first() {
        Some(TokenTree::Ident(word)) => {
            if word != "self" {
                base.push(word.to_string());
            }
            if is_path(tokens) {
                return tree(&tokens[3..], base, found);
            }
            let name = match tokens.get(1..3) {
                Some([TokenTree::Ident(word), TokenTree::Ident(alias)]) if word == "as" => alias.to_string(),
                _ => base.last().cloned().unwrap_or_default(),
            };
            found.push(Named { path: base, name });
        }
        Some(TokenTree::Group(group)) if group.delimiter() == Delimiter::Brace => {
            let inner: Vec<TokenTree> = group.stream().into_iter().collect();
            let is_comma =
                |token: &TokenTree| matches!(token, TokenTree::Punct(punct) if punct.as_char() == ',');
            inner.split(is_comma).for_each(|part| tree(part, base.clone(), found));
        }
        Some(TokenTree::Punct(punct)) if punct.as_char() == '*' => {
            found.push(Named { path: base, name: "*".to_owned() });
        }
        // Arguments of a generic: the path ends before them.
        Some(_) if !base.is_empty() => {
            let name = base.last().cloned().unwrap_or_default();
            found.push(Named { path: base, name });
        }
        _ => (),
    }
}

/// Whether tokens begin with a word and `::`.
fn is_path(tokens: &[TokenTree]) -> bool {
    let is_colon = |token: &TokenTree| matches!(token, TokenTree::Punct(punct) if punct.as_char() == ':');
    matches!(tokens, [TokenTree::Ident(_), a, b, _, ..] if is_colon(a) && is_colon(b))
}

fn is_cfg_test(attribute: Option<&TokenTree>) -> bool {
    matches!(attribute, Some(TokenTree::Group(group)) if group.stream().to_string().replace(' ', "") == "cfg(test)")
}

fn is_end_of_item(token: &TokenTree) -> bool {
    match token {
        TokenTree::Group(group) => group.delimiter() == Delimiter::Brace,
        TokenTree::Punct(punct) => punct.as_char() == ';',
        _ => false,
    }
}

/// The module that a file of a crate's source is; the crate's own is empty.
fn module_of(file: &Path, source: &Path) -> Module {
    let below = file.strip_prefix(source).expect("the file is one of the crate").with_extension("");
    let mut parts: Module = below.iter().map(|part| part.to_string_lossy().into_owned()).collect();
    if matches!(parts.last().map(String::as_str), Some("mod" | "lib" | "main")) {
        parts.pop();
    }
    parts
}

/// Rooms of a folder, and arrows between them.
fn arrows_of(folder: &str) -> (BTreeSet<String>, BTreeMap<(String, String), String>) {
    let folder = Path::new(folder);
    let source = folder.ancestors().find(|above| above.ends_with("src")).expect("the folder lies in src");
    let base: Module = folder
        .strip_prefix(source)
        .expect("it lies there")
        .iter()
        .map(|part| part.to_string_lossy().into_owned())
        .collect();
    let files: Vec<(String, Module, String)> = files_below(&folder.display().to_string(), "rs")
        .into_iter()
        .filter(|file| !file.iter().any(|part| part == "tests" || part == "tests.rs" || part == "bin"))
        .map(|file| (file.display().to_string(), module_of(&file, source), text_of(&file)))
        .collect();
    let rooms: BTreeSet<String> =
        files.iter().filter_map(|(_, module, _)| module.get(base.len()).cloned()).collect();
    // Rooms behind the names that the folder's own file passes on.
    let mut passed_on: BTreeMap<String, String> = BTreeMap::new();
    for (file, module, text) in files.iter().filter(|(_, module, _)| *module == base) {
        for Named { path, name } in named_by(text, module) {
            let Some(room) = path.strip_prefix(&base[..]).and_then(|rest| rest.first()) else { continue };
            if rooms.contains(room) && path.len() > base.len() + 1 {
                assert!(
                    name != "*",
                    "{file}: name what is passed on of {room}, so that arrows to it can be seen"
                );
                passed_on.insert(name, room.clone());
            }
        }
    }
    let mut arrows = BTreeMap::new();
    for (file, module, text) in &files {
        let Some(from) = module.get(base.len()) else { continue };
        for Named { path, .. } in named_by(text, module) {
            let Some(item) = path.strip_prefix(&base[..]).and_then(|rest| rest.first()) else { continue };
            let to = if rooms.contains(item) { Some(item) } else { passed_on.get(item) };
            if let Some(to) = to.filter(|to| *to != from) {
                arrows.entry((from.clone(), to.clone())).or_insert_with(|| file.clone());
            }
        }
    }
    (rooms, arrows)
}

#[test]
fn rooms_name_what_their_list_says_and_nothing_else() {
    let lists = lists(&text_of(Path::new("ARCHITECTURE.md")));
    assert!(!lists.is_empty(), "ARCHITECTURE.md lists no rooms: the walk is broken");
    let mut faults = Vec::new();
    for list in lists {
        let (rooms, arrows) = arrows_of(&list.folder);
        assert!(rooms.len() > 1, "{} has no rooms: the walk is broken", list.folder);
        faults.extend(list.faults(&rooms, &arrows));
    }
    assert!(faults.is_empty(), "change the code, or the lists in ARCHITECTURE.md: {faults:#?}");
}

#[test]
fn list_that_differs_from_the_source_is_refused() {
    let document = "```text\nrooms of x/src\na\nb, c → a\n```\nd → a";
    let room = |name: &str| name.to_owned();
    let rooms: BTreeSet<String> = ["a", "b", "c"].map(room).into();
    let arrow = |from, to| ((room(from), room(to)), room("file"));
    let faults = |document: &str, rooms: &BTreeSet<String>, arrows: &[((String, String), String)]| {
        let list = lists(document).pop().expect("one list");
        list.faults(rooms, &arrows.iter().cloned().collect()).len()
    };
    let whole = [arrow("b", "a"), arrow("c", "a")];
    assert_eq!(faults(document, &rooms, &whole), 0);
    assert_eq!(faults(document, &rooms, &whole[1..]), 1, "an arrow that no file has");
    let more = [whole.as_slice(), &[arrow("a", "c")]].concat();
    assert_eq!(faults(document, &rooms, &more), 1, "an arrow that is not listed");
    assert_eq!(faults(&document.replace("a\nb", "a → c\nb"), &rooms, &more), 1, "a circle");
    assert_eq!(faults(document, &["a", "b"].map(room).into(), &whole), 1, "a room that is not there");
    assert_eq!(faults(&document.replace("a\nb", "a, d\nb"), &["a", "b", "c"].map(room).into(), &whole), 1);
}

#[test]
fn paths_are_found_wherever_they_stand() {
    let found = |code: &str| -> Vec<String> {
        let module = ["store", "sql"].map(str::to_owned).to_vec();
        named_by(code, &module).into_iter().map(|Named { path, .. }| path.join("::")).collect()
    };
    assert_eq!(found("use crate::{a::B, c::{self, d::*}};"), ["a::B", "c", "c::d"]);
    assert_eq!(found("fn f(x: super::super::A) -> crate::b::C<crate::D> {}"), ["A", "b::C", "D"]);
    assert_eq!(found("use self::a::B as C; mod m { use super::d; }"), ["store::sql::a::B", "store::sql::d"]);
    assert_eq!(found("use a::B;"), ["store::sql::a::B"], "it may be a room of the folder");
    assert_eq!(found("/// [`crate::a`]\nconst A: &str = \"crate::b\"; // crate::c"), [""; 0]);
    assert_eq!(found("#[cfg(test)]\nmod tests { use crate::a; }\nuse crate::b;"), ["b"]);
    assert_eq!(found("#[cfg(test)]\nuse crate::a;\nuse crate::b;"), ["b"]);
}
