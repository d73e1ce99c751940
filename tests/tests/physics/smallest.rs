//! The smallest scene is baked and drawn as any other.

use std::f32::consts::PI;

use lightkiln_client::bake::LoadedBake;
use lightkiln_client::fetch::Source;
use lightkiln_client::kinds;
use lightkiln_client::lights::parse_light;
use lightkiln_client::preview::{Backend, View, render};
use lightkiln_tests::harness::{Recipe, bake};
use lightkiln_tests::scenes::lone_triangle;
use serde_json::json;

/// Albedo of the triangle, see `scales`.
const ALBEDO: [f32; 3] = [0.8, 0.8, 0.78];

/// A triangle alone reflects what lights give it, an even sky's whole hemisphere and a sun's irradiance, and no other light comes to it.
#[test]
fn lone_triangle_reflects_the_light_of_sky_and_sun_alone() {
    for kind in ["prt", "sh"] {
        let recipe = Recipe { kind, settings: json!({ "preset": "draft", "transport_rays": 128 }) };
        let folder = tempfile::tempdir().unwrap();
        bake(lone_triangle(), &recipe).unwrap().write(folder.path()).unwrap();
        let loaded = LoadedBake::load(&Source::bundle(folder.path()).unwrap(), &kinds::all()).unwrap();
        assert_eq!(loaded.scene.draws.triangle_count(), 1);
        let of = |lights: &[&str]| {
            let lights = lights.iter().map(|light| parse_light(light).unwrap()).collect();
            let (view, _) = View::of_bake(&loaded, None, Some(lights)).unwrap();
            let view = View { width: 96, height: 64, samples: 1, ..view };
            let picture = render(&loaded, &view, Backend::Cpu).unwrap();
            assert!(picture.converged);
            picture.linear
        };
        let dark = of(&[]);
        assert!(dark.iter().all(|radiance| *radiance == [0.0; 3]), "{kind}: nothing shines");
        let sunlit = of(&["sun dir=0,-1,0 color=1,1,1 irradiance=3"]);
        let lit: Vec<usize> = (0..sunlit.len()).filter(|pixel| sunlit[*pixel][0] > 0.0).collect();
        assert!((100..3000).contains(&lit.len()), "{kind}: the triangle has {} pixels", lit.len());
        let skylit = of(&["sky zenith=1,1,1 horizon=1,1,1 strength=2"]);
        for pixel in lit {
            for (channel, albedo) in ALBEDO.into_iter().enumerate() {
                let [sun, sky] = [&sunlit, &skylit].map(|picture| picture[pixel][channel]);
                assert!((sun / (albedo * 3.0 / PI) - 1.0).abs() < 0.01, "{kind}: {sun} at {pixel}");
                assert!((sky / (albedo * 2.0) - 1.0).abs() < 0.03, "{kind}: {sky} at {pixel}");
            }
        }
    }
}
