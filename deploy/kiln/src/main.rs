//! The program `kiln` with the kinds of bake that Lightkiln has.

use std::process::ExitCode;

use kiln::kinds::KindTables;

fn main() -> ExitCode {
    kiln::run(&KindTables::new())
}
