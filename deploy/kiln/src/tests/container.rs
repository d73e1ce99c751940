//! The image's Dockerfile: its instructions, in order.

use super::{is_pinned, root, text_of};

/// Instructions and what stands behind them; lines that end with a backslash are joined.
fn instructions(text: &str) -> Vec<(String, String)> {
    let is_comment = |line: &&str| line.trim_start().starts_with('#');
    let lines: Vec<&str> = text.lines().filter(|line| !is_comment(line)).collect();
    let joined = lines.join("\n").replace("\\\n", " ");
    let lines = joined.lines().map(str::trim).filter(|line| !line.is_empty());
    lines
        .map(|line| {
            let (name, rest) = line.split_once(' ').unwrap_or((line, ""));
            assert!(name.bytes().all(|byte| byte.is_ascii_uppercase()), "no instruction: {line}");
            (name.to_owned(), rest.trim().to_owned())
        })
        .collect()
}

/// Arguments of an instruction, in the order of the file.
fn all<'a>(instructions: &'a [(String, String)], name: &str) -> Vec<&'a str> {
    instructions.iter().filter(|(known, _)| known == name).map(|(_, rest)| rest.as_str()).collect()
}

#[test]
fn image_is_built_in_stages_from_pinned_bases_and_runs_as_nobody_special() {
    let instructions = instructions(&text_of("deploy/Dockerfile"));
    let known = [
        "FROM",
        "WORKDIR",
        "COPY",
        "RUN",
        "ENV",
        "VOLUME",
        "EXPOSE",
        "USER",
        "STOPSIGNAL",
        "ENTRYPOINT",
        "CMD",
    ];
    for (name, _) in &instructions {
        assert!(known.contains(&name.as_str()), "{name} is new here: say in this test what must hold of it");
    }
    let bases = all(&instructions, "FROM");
    assert_eq!(bases.len(), 2, "one stage builds, one is the image: {bases:?}");
    for base in &bases {
        assert!(is_pinned(base.split(' ').next().unwrap()), "{base}");
    }
    assert!(bases[0].ends_with(" AS build") && bases[1].ends_with("-slim"), "{bases:?}");
    let last_stage = instructions.iter().rposition(|(name, _)| name == "FROM").unwrap();
    let image = &instructions[last_stage..];
    let copied = all(image, "COPY");
    assert_eq!(
        copied,
        ["--from=build /src/target/release/kiln /usr/local/bin/kiln"],
        "nothing but the binary"
    );
    let user = all(image, "USER");
    let ids: Vec<u32> = user[0].split(':').map(|id| id.parse().expect("users are numbers here")).collect();
    assert!(user.len() == 1 && ids.len() == 2 && ids.iter().all(|id| *id >= 10_000), "{user:?}");
    let runs_after = image.iter().skip_while(|(name, _)| name != "USER");
    assert!(runs_after.clone().count() > 1 && runs_after.clone().all(|(name, _)| name != "RUN"));
    assert_eq!(all(image, "ENTRYPOINT"), ["[\"kiln\"]"]);
    assert_eq!(all(image, "STOPSIGNAL"), ["SIGTERM"]);
    assert_eq!(all(image, "EXPOSE"), ["7410"]);
    for run in all(image, "RUN") {
        assert!(!run.contains("apt-get install") || run.contains("rm -rf /var/lib/apt/lists"), "{run}");
        assert!(!run.contains("curl") && !run.contains("wget"), "{run}");
    }
}

#[test]
fn image_is_built_by_the_toolchain_that_the_workspace_asks_for_with_its_lock_file() {
    let instructions = instructions(&text_of("deploy/Dockerfile"));
    let manifest = text_of("Cargo.toml");
    let wanted = manifest.lines().find_map(|line| line.strip_prefix("rust-version = \"")).unwrap();
    let wanted = wanted.trim_end_matches('"');
    let base = all(&instructions, "FROM")[0];
    assert!(base.starts_with(&format!("rust:{wanted}.")), "{base} is not Rust {wanted}");
    assert!(all(&instructions, "RUN")[0].contains("cargo build --release --locked --package kiln"));
}

#[test]
fn image_is_built_from_sources_alone() {
    let ignored = std::fs::read_to_string(root().join(".dockerignore")).unwrap();
    for folder in [".git", "target"] {
        assert!(ignored.lines().any(|line| line == folder), "{folder} would be sent to every build");
    }
}
