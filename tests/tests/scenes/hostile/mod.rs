//! Hostile bytes: the fuzz targets of `tests/fuzz`, each over thousands of mutations of good input, the same in every
//! run. Whatever the bytes: no panic, no more memory than they may ask for, and what is taken means what it says.

mod mutations;
#[path = "../../../fuzz/src/targets/mod.rs"]
mod targets;

use mutations::Mutator;
use targets::{TARGETS, Target};

/// Mutated inputs of a target, where `KILN_FUZZ_CASES` asks for no other number.
const CASES: u64 = 3000;

/// The number of cases: more than the ordinary tests have time for, where the environment asks for them.
fn cases() -> u64 {
    let asked = std::env::var("KILN_FUZZ_CASES").ok();
    asked.map_or(CASES, |asked| asked.parse().expect("KILN_FUZZ_CASES is a number"))
}

/// Most memory that a target had at a time while it read the bytes, and whether it took them.
fn measured(target: &Target, bytes: &[u8]) -> (u64, bool) {
    let mut was_taken = false;
    let memory = allocation_counter::measure(|| was_taken = (target.read)(bytes));
    (memory.bytes_max, was_taken)
}

/// Fault in a target's reading of the bytes.
fn fault(target: &Target, bytes: &[u8]) -> Option<String> {
    let (memory, _) = measured(target, bytes);
    let max = (target.memory_max)(bytes.len());
    (memory > max).then(|| format!("{memory} bytes of memory for {} bytes, at most {max}", bytes.len()))
}

/// Says which case it was when a target panics.
struct Case(&'static str, u64, Vec<u8>);

impl Drop for Case {
    fn drop(&mut self) {
        if std::thread::panicking() {
            let shown = String::from_utf8_lossy(&self.2[..self.2.len().min(600)]);
            eprintln!("in case {} of {}, {} bytes: {shown:?}", self.1, self.0, self.2.len());
        }
    }
}

fn hold(name: &str) {
    let target = TARGETS.iter().find(|target| target.name == name).expect("a target of that name");
    let seeds = (target.seeds)();
    let cases = cases();
    let mut taken = 0;
    for index in 0..cases {
        // The seeds themselves come first.
        let bytes = match seeds.get(index as usize) {
            Some(seed) => seed.clone(),
            None => Mutator::new(index).mutated(&seeds),
        };
        let case = Case(target.name, index, bytes);
        let fault = fault(target, &case.2);
        assert!(fault.is_none(), "{fault:?}");
        taken += u64::from((target.read)(&case.2));
        (target.check)(&case.2);
    }
    eprintln!("{name}: {taken} of {cases} inputs were taken");
    assert!(
        taken >= seeds.len() as u64 / 2 && taken < cases,
        "{taken} inputs were taken: the mutations are no good"
    );
}

macro_rules! held {
    ($($test:ident: $name:literal;)+) => {
        $(#[test] fn $test() { hold($name) })+

        #[test]
        fn every_target_is_held() {
            let held = [$($name),+];
            assert!(TARGETS.iter().map(|target| target.name).eq(held));
            let manifest = include_str!("../../../fuzz/Cargo.toml");
            for name in held {
                assert!(manifest.contains(&format!("name = \"{name}\"")), "{name} is no program of tests/fuzz");
            }
        }
    };
}

held! {
    hostile_clusters_do_no_harm: "cluster";
    hostile_layers_do_no_harm: "layers";
    hostile_probes_do_no_harm: "probes";
    hostile_fields_do_no_harm: "field";
    hostile_tetrahedra_do_no_harm: "tetrahedra";
    hostile_voxels_do_no_harm: "voxels";
    hostile_volumes_do_no_harm: "transfer";
    hostile_geometry_does_no_harm: "geometry";
    hostile_textures_do_no_harm: "texture";
    hostile_patches_do_no_harm: "patches";
    hostile_directories_do_no_harm: "directory";
    hostile_manifests_do_no_harm: "manifest";
    hostile_jobs_do_no_harm: "job";
    hostile_bundles_do_no_harm: "bundle";
    hostile_gltf_does_no_harm: "gltf";
    hostile_ranges_do_no_harm: "range";
    hostile_cursors_do_no_harm: "cursor";
    hostile_places_do_no_harm: "place";
}

#[test]
fn memory_that_a_length_field_asks_for_is_noticed() {
    let believes = Target {
        name: "believes",
        read: |bytes| vec![0_u8; usize::from(bytes[0]) << 20].len() > 1,
        check: |_| (),
        seeds: Vec::new,
        memory_max: |bytes| (1 << 20) + bytes as u64,
    };
    assert!(fault(&believes, &[1]).is_none());
    assert!(fault(&believes, &[200]).is_some_and(|told| told.contains("209715200 bytes of memory")));
}
