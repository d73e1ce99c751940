//! `kiln` with one kind of bake more: constant ambient light.

use std::process::ExitCode;

fn main() -> ExitCode {
    kiln::run(&lightkiln_tests::ambient::tables())
}
