//! Settings, lights and figures that the tests share.

use glam::Vec3;
use lightkiln_proto::scene::{LightKind, SceneLight};
use lightkiln_tests::harness::{Compared, Recipe, RelitReceiver};
use lightkiln_worker::rays::Tracer;
use lightkiln_worker::reference::Lighting;
use lightkiln_worker::scene::{Bundle, Limits, import};
use serde_json::json;

/// Makes two tests of a function that takes a kind of bake: `name::prt` and `name::sh`.
macro_rules! in_both_kinds {
    ($($name:ident),+ $(,)?) => {
        $(mod $name {
            #[test]
            fn prt() {
                super::$name("prt");
            }
            #[test]
            fn sh() {
                super::$name("sh");
            }
        })+
    };
}
pub(crate) use in_both_kinds;

/// Settings for about so many receivers in a scene of few triangles.
pub fn small(kind: &'static str, receivers: u32) -> Recipe {
    let settings = json!({ "preset": "draft", "receivers_target": receivers * 5, "transport_rays": 128 });
    Recipe { kind, settings }
}

/// Settings with texels of a given size.
pub fn with_texels(kind: &'static str, texel_m: f32, transport_rays: u32) -> Recipe {
    let settings = json!({ "preset": "draft", "texel_m": texel_m, "transport_rays": transport_rays });
    Recipe { kind, settings }
}

/// Settings for places where small things count. Of patches: more columns than a draft has and half its error of
/// truncation, as a draft is too bright there by a tenth and more; 6 to 8 % of it are left with these.
pub fn careful(kind: &'static str, texel_m: f32) -> Recipe {
    match kind {
        "prt" => {
            let settings =
                json!({ "preset": "medium", "texel_m": texel_m, "rank_error": 0.005, "emitter_rays": 32 });
            Recipe { kind, settings }
        }
        _ => with_texels(kind, texel_m, 128),
    }
}

pub fn luminance([r, g, b]: [f32; 3]) -> f32 {
    0.2126 * r + 0.7152 * g + 0.0722 * b
}

pub fn mean(receivers: &[&RelitReceiver]) -> f32 {
    receivers.iter().map(|receiver| luminance(receiver.indirect)).sum::<f32>() / receivers.len() as f32
}

/// Rays against the scene's own triangles.
pub fn tracer(bundle: &[u8]) -> Tracer {
    let limits = Limits::default();
    let bundle = Bundle::from_bytes(bundle.to_vec(), &limits).unwrap();
    let scene = import(&bundle, &limits).unwrap().scene;
    let corners: Vec<_> = scene
        .instances
        .iter()
        .flat_map(|i| i.triangles.iter().map(|t| t.map(|v| i.positions_m[v as usize])))
        .collect();
    Tracer::new(&corners, None)
}

/// One light and nothing else.
pub fn only(kind: LightKind, strength: f32) -> Lighting {
    let light = SceneLight { name: "light".into(), kind, strength: [strength; 3] };
    Lighting { lights: vec![light], ..Lighting::default() }
}

/// A point light of 10 W·sr⁻¹.
pub fn lamp_at(position_m: Vec3) -> Lighting {
    only(LightKind::Point { position_m: position_m.to_array(), range_m: None }, 10.0)
}

/// About `count` of many, evenly through the list.
pub fn spread(all: &[u32], count: usize) -> Vec<u32> {
    all.iter().step_by(all.len().div_ceil(count).max(1)).copied().collect()
}

/// Energy of the bake over that of the reference, and the standard error of it.
pub fn energy_ratio(pairs: &[Compared]) -> [f64; 2] {
    assert!(!pairs.is_empty(), "nothing to compare");
    let reference: f64 = pairs.iter().map(|pair| pair.reference).sum();
    assert!(reference > 0.0, "the reference is dark: the comparison shows nothing");
    let error = pairs.iter().map(|pair| pair.error * pair.error).sum::<f64>().sqrt();
    [pairs.iter().map(|pair| pair.baked).sum::<f64>() / reference, error / reference]
}

/// Root mean square of the difference over the mean of the reference, the reference's own noise subtracted.
pub fn rel_rmse(pairs: &[Compared]) -> f64 {
    let mean = pairs.iter().map(|pair| pair.reference).sum::<f64>() / pairs.len() as f64;
    let square = |pair: &Compared| (pair.baked - pair.reference).powi(2) - pair.error.powi(2);
    (pairs.iter().map(square).sum::<f64>() / pairs.len() as f64).max(0.0).sqrt() / mean
}

/// Panics when the energies differ by more than `tolerance` and three standard errors.
pub fn assert_same_energy(what: &str, pairs: &[Compared], tolerance: f64) {
    let [ratio, error] = energy_ratio(pairs);
    println!("{what}: energy {ratio:.4} ± {error:.4}, rel. RMSE {:.4} of {}", rel_rmse(pairs), pairs.len());
    assert!((ratio - 1.0).abs() <= tolerance + 3.0 * error, "{what}: energy ratio {ratio} ± {error}");
}
