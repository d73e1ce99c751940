//! Tests of all passes: shaders are valid and agree with their Rust twins, adapter and reference agree in numbers.

mod agreement;
mod light;
mod normative;
mod shaders;

use std::io::Write;

use lightkiln_proto::prt::BasisKind;

use crate::bake::LoadedBake;
use crate::fixture;
use crate::lights::{Caster, Sky};
use crate::passes::gpu::Gpu;
use crate::passes::shadow::ShadowPlan;
use crate::preview::{Prepared, View};

/// The adapter, or a line on standard error that says that `test` is skipped.
///
/// With `KILN_REQUIRE_ADAPTER=1` a missing adapter fails the test.
pub(crate) fn adapter_or_skip(test: &str) -> Option<Gpu> {
    match Gpu::open() {
        Ok(gpu) => Some(gpu),
        Err(error) => {
            assert!(std::env::var_os("KILN_REQUIRE_ADAPTER").is_none(), "{test} needs an adapter: {error}");
            // Not through `eprintln!`: the test harness swallows that.
            let line = format!("SKIPPED {test}: {error}\n");
            std::io::stderr().write_all(line.as_bytes()).unwrap();
            None
        }
    }
}

/// The fixture with the view of its own file, small enough for the processor.
pub(crate) fn fixture_view() -> (LoadedBake, View) {
    fixture_view_of(BasisKind::Sh)
}

/// As [`fixture_view`], in some basis.
pub(crate) fn fixture_view_of(basis: BasisKind) -> (LoadedBake, View) {
    let bake = fixture::bake(basis);
    let (view, notes) = View::of_bake(&bake, None, Vec::new());
    assert!(notes.is_empty(), "{notes:?}");
    (bake, View { width: 160, height: 120, shadow_side: 512, emitter_scale: vec![1.5], ..view })
}

/// What backends start from.
pub(crate) fn prepared<'a>(bake: &'a LoadedBake, view: &'a View) -> Prepared<'a> {
    let plan = ShadowPlan::new(&Caster::of(&view.lights), bake.manifest.bounds_m, view.shadow_side).unwrap();
    Prepared { bake, view, plan, sky: Sky::of(&view.lights) }
}
