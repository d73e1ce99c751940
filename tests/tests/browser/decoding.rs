//! Chunks: the same numbers, and the same refusals.

#[path = "../../fuzz/src/targets/container.rs"]
mod container;

use std::collections::BTreeMap;

use lightkiln_proto::chunk::{
    ChunkError, EncodedCluster, IRRADIANCE_MAX, QuantisationSettings, VERSION, decode_cluster_prefix,
    encode_cluster,
};
use lightkiln_proto::content::{ClusterTransport, EmitterIrradiance, Receivers, TexelEdge};
use serde_json::json;

use super::fields::{self, Fields};
use super::files::{Answer, Files};
use super::mutations::Mutator;
use super::{browser_at, root, served};
use container::{packed, unpacked};

const MODULE: &str = "/pages/decode.js";
/// Mutated inputs of each fixture, beside all its prefixes.
const MUTATIONS: u64 = 400;

/// Chunks of the present version, by the file's name: those of the kinds that a browser reads.
fn fixtures() -> Vec<(String, Vec<u8>)> {
    let ending = format!("-v{VERSION}.lkc");
    let entries = std::fs::read_dir(root().join("proto/fixtures")).expect("fixtures");
    let paths = entries.map(|entry| entry.expect("a folder can be read to its end").path());
    let name = |path: &std::path::Path| path.file_name().map(|name| name.to_string_lossy().into_owned());
    let mut found: Vec<(String, Vec<u8>)> = paths
        .filter_map(|path| Some((name(&path)?, path)))
        .filter(|(name, _)| {
            name.ends_with(&ending)
                && !["probes", "field", "tetrahedra", "voxels", "transfer"]
                    .iter()
                    .any(|kind| name.starts_with(kind))
        })
        .map(|(name, path)| (name, std::fs::read(path).expect("a fixture can be read")))
        .collect();
    found.sort();
    assert_eq!(found.len(), 6, "a fixture of each kind, and a cluster with near hits");
    found
}

/// A server of chunks at `/chunk/<place>`.
fn serving(chunks: Vec<Vec<u8>>) -> Files {
    served(move |request| {
        let place: usize = request.path.strip_prefix("/chunk/")?.parse().ok()?;
        Some(chunks.get(place).map_or_else(|| Answer::empty(404), |chunk| Answer::of(chunk.clone())))
    })
}

fn as_fields(json: &serde_json::Value) -> Fields {
    let fields: BTreeMap<String, String> = serde_json::from_value(json.clone()).expect("names and texts");
    Fields(fields)
}

#[test]
#[ignore = "needs chromium"]
fn chromium_decodes_fixtures_to_the_numbers_of_rust() {
    let fixtures = fixtures();
    let files = serving(fixtures.iter().map(|(_, bytes)| bytes.clone()).collect());
    let browser = browser_at(&files);
    for (place, (name, bytes)) in fixtures.iter().enumerate() {
        let found = as_fields(&browser.run(MODULE, "fields", json!([format!("/chunk/{place}")])));
        let wanted = fields::of_chunk(bytes).expect("a fixture decodes");
        assert!(wanted.0.len() > 1, "{name} has next to no fields");
        assert_eq!(found, wanted, "{name}");
    }
}

#[test]
#[ignore = "needs chromium"]
fn chromium_decodes_every_layer_of_a_larger_cluster() {
    let encoded = encoded_cluster(160);
    assert!(encoded.layers.len() > 1, "one layer proves nothing");
    let files = serving(vec![encoded.bytes.clone()]);
    let browser = browser_at(&files);
    for layer in &encoded.layers {
        let found = browser.run(MODULE, "prefixFields", json!(["/chunk/0", layer.bytes]));
        let bytes = &encoded.bytes[..layer.bytes as usize];
        let (cluster, decoded) = decode_cluster_prefix(bytes, encoded.bytes.len() as u64).expect("a layer");
        let mut wanted = Fields::default();
        fields::cluster(&mut wanted, &cluster);
        assert_eq!(as_fields(&found["fields"]), wanted, "{layer:?}");
        assert_eq!(found["layer"], serde_json::to_value(&decoded).expect("a layer is JSON"));
    }
}

fn encoded_cluster(side: u16) -> EncodedCluster {
    encode_cluster(&larger_cluster(side), QuantisationSettings::default()).expect("it can be encoded")
}

/// `side`² receivers of all levels with irradiance of as many codes, normals in all directions, and albedos beyond a palette.
fn larger_cluster(side: u16) -> ClusterTransport {
    let texel: Vec<[u16; 2]> = (0..side * side).map(|index| [index % side, index / side]).collect();
    let count = texel.len();
    let share = |index: usize, by: f32| (index as f32 * by).fract();
    let normal = |index: usize| {
        let [x, y, z] = [0.618, 0.755, 0.43].map(|by| share(index, by) - 0.5);
        let length = (x * x + y * y + z * z).sqrt();
        [x, y, z].map(|axis| axis / length)
    };
    let rank = 20;
    let keys: Vec<u64> = (0..70).map(|index| 0x0100_0000_0000_0000 + 977 * index).collect();
    let (u, vt) =
        ((0..count * rank).map(|at| share(at, 0.618) - 0.5), (0..rank * 70).map(|at| share(at, 0.7)));
    ClusterTransport {
        bounds_m: [[-3.1, 0.0, 7.7], [11.3, 2.9, 7.9]],
        receivers: Receivers {
            blocks: vec![0xfedc_ba98_7654_3210],
            block: vec![0; count],
            position_m: (0..count)
                .map(|at| [-3.1 + 14.4 * share(at, 0.618), 2.9 * share(at, 0.7), 7.7 + 0.2 * share(at, 0.3)])
                .collect(),
            normal: (0..count).map(normal).collect(),
            albedo: (0..count).map(|at| [share(at, 0.1), share(at, 0.618), 0.5]).collect(),
            emission: (0..count).map(|at| [if at % 7 == 0 { share(at, 3.3) } else { 0.0 }; 3]).collect(),
            links: (0..count).map(|at| (at % 16) as u8).collect(),
            coverage: (0..count).map(|at| (at * 31) as u16).collect(),
            edge: (0..count).map(|at| TexelEdge((at * 97) as u16)).collect(),
            texel,
        },
        factors: lightkiln_proto::content::TransportFactors {
            keys,
            rank: rank as u32,
            u: u.collect(),
            vt: vt.collect(),
            ..Default::default()
        },
        emitters: vec![EmitterIrradiance {
            emitter: 1,
            irradiance: (0..count)
                .map(|at| [0, 1, 2].map(|channel| every_irradiance((3 * at + channel) as f32)))
                .collect(),
        }],
        near: Default::default(),
    }
}

/// Irradiance of code `number`, or of the last one.
fn every_irradiance(number: f32) -> f32 {
    libm::exp2f((number.clamp(1.0, 65_535.0) - 32_768.0) / 512.0).min(IRRADIANCE_MAX)
}

/// Inputs: all prefixes of the fixtures, and mutations of them as they are and beneath their compression.
fn inputs() -> Vec<Vec<u8>> {
    let chunks: Vec<Vec<u8>> = fixtures().into_iter().map(|(_, bytes)| bytes).collect();
    let mut inputs = chunks.clone();
    inputs.extend(chunks.iter().flat_map(|chunk| (0..chunk.len()).map(|length| chunk[..length].to_vec())));
    // Beside fixtures, whose sections are short, one with every part of compression.
    for chunk in chunks.iter().chain([&encoded_cluster(24).bytes]) {
        let (stored, raw) = ([chunk.clone()], [unpacked(chunk)]);
        inputs.extend((0..MUTATIONS).map(|seed| Mutator::new(seed).mutated(&stored)));
        inputs.extend((0..2 * MUTATIONS).filter_map(|seed| packed(&Mutator::new(seed).mutated(&raw))));
    }
    inputs
}

/// Words of a verdict that both decoders have alike: numbers that are none have other words in Rust, and so has zstd.
fn words(error: &ChunkError) -> Option<String> {
    let is_same = !matches!(error, ChunkError::BadNumber { .. } | ChunkError::Compression { .. });
    is_same.then(|| error.to_string())
}

/// Fault in a verdict of the browser.
fn fault(input: &[u8], told: &str) -> Option<String> {
    let version = input.get(4..6).map(|version| u16::from_le_bytes([version[0], version[1]]));
    if version.is_some_and(|version| (1..VERSION).contains(&version)) && input.starts_with(b"LKCH") {
        return (!told.starts_with("version: ")).then(|| "an older version was not refused".to_owned());
    }
    match fields::of_chunk(input) {
        Ok(fields) => {
            let wanted = format!("taken {}", fields.digest());
            (told != wanted).then(|| "Rust takes it, with other fields if the browser does".to_owned())
        }
        // A section that does not unpack is told as such, in words of zstd's own.
        Err(error) if told.starts_with("compression: ") => {
            let is_number = matches!(error, ChunkError::BadNumber { .. });
            (is_number).then(|| format!("Rust unpacks it: {error}"))
        }
        Err(error) => {
            let is_error = !told.starts_with("taken ") && !told.starts_with("fault: ");
            let is_same = words(&error).is_none_or(|words| told.ends_with(&format!(": {words}")));
            (!is_error || !is_same).then(|| format!("Rust says: {error}"))
        }
    }
}

#[test]
#[ignore = "needs chromium"]
fn chromium_refuses_hostile_chunks_as_rust_does() {
    let inputs = inputs();
    let together: Vec<u8> = inputs
        .iter()
        .flat_map(|input| (input.len() as u32).to_le_bytes().into_iter().chain(input.iter().copied()))
        .collect();
    let files = serving(vec![together]);
    let found = browser_at(&files).run(MODULE, "verdicts", json!(["/chunk/0"]));
    let told: Vec<String> = serde_json::from_value(found["told"].clone()).expect("texts");
    assert_eq!(told.len(), inputs.len());
    let faults: Vec<String> = inputs
        .iter()
        .zip(&told)
        .enumerate()
        .filter_map(|(place, (input, told))| Some(format!("{place}: {} — {told}", fault(input, told)?)))
        .collect();
    let taken = told.iter().filter(|told| told.starts_with("taken ")).count();
    eprintln!("{taken} of {} inputs were taken, the longest took {} ms", told.len(), found["longestMs"]);
    assert!(taken > 20 && taken < inputs.len() / 2, "{taken} inputs were taken: the mutations are no good");
    assert!(faults.is_empty(), "{} faults: {:#?}", faults.len(), &faults[..faults.len().min(20)]);
}

#[test]
fn verdicts_that_differ_are_noticed() {
    let (_, bytes) = &fixtures()[0];
    let good = format!("taken {}", fields::of_chunk(bytes).expect("a fixture decodes").digest());
    assert!(fault(bytes, &good).is_none());
    assert!(fault(bytes, "taken 0").is_some() && fault(bytes, "truncated: header").is_some());
    let short = &bytes[..20];
    let told = fields::of_chunk(short).expect_err("it is cut off").to_string();
    assert!(fault(short, &format!("truncated: {told}")).is_none());
    for wrong in [good.as_str(), "fault: TypeError", "truncated: other words"] {
        assert!(fault(short, wrong).is_some(), "{wrong}");
    }
}
