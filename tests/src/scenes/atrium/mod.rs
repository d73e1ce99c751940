//! The showpiece: a court of 18 × 9 m with two storeys of arcades, vaulted galleries, a fountain and coloured cloths,
//! under the open sky.
//!
//! The court's centre is the origin; x runs along it. Bays are 3 m wide, galleries 3 m deep.

mod furnishing;
mod plan;
mod structure;

use glam::Vec3;

use super::glb::{Glb, Lamp, MaterialId, Surface};
use super::texture;

/// The materials of the building.
struct Palette {
    ashlar: MaterialId,
    stone: MaterialId,
    plaster: MaterialId,
    court_tiles: MaterialId,
    gallery_tiles: MaterialId,
    wood: MaterialId,
    water: MaterialId,
    terracotta: MaterialId,
    leaves: MaterialId,
    cloths: [MaterialId; 4],
}

/// The atrium in morning sun.
pub fn atrium() -> Vec<u8> {
    let mut glb = Glb::new("atrium");
    let palette = palette(&mut glb);
    structure::build(&mut glb, &palette);
    furnishing::build(&mut glb, &palette);

    glb.light("sun", Lamp::Sun, [10.0, 9.0, 7.5], Vec3::new(4.2, 14.0, 4.5), Vec3::ZERO);
    glb.camera("court", Vec3::new(8.2, 1.8, 2.1), Vec3::new(-7.0, 3.5, -1.7), 1.12);
    glb.camera("gallery", Vec3::new(7.6, 1.8, -5.8), Vec3::new(-9.0, 2.5, -5.3), 1.0);
    glb.camera("balcony", Vec3::new(9.7, 7.2, 0.5), Vec3::new(-6.0, 2.2, -1.4), 1.1);
    glb.finish()
}

fn palette(glb: &mut Glb) -> Palette {
    let cloths = [
        ("crimson cloth", [158, 24, 28], [222, 176, 84], 0, true),
        ("blue cloth", [26, 58, 148], [226, 214, 186], 3, true),
        ("green cloth", [22, 106, 58], [222, 176, 84], 0, true),
        ("saffron cloth", [226, 138, 26], [150, 30, 26], 4, false),
    ]
    .map(|(name, ground, stripe, stripes, along)| {
        let texture = glb.texture(name, &texture::striped_cloth(128, ground, stripe, stripes, along));
        glb.material(Surface::diffuse(name, [1.0; 3]).double_sided().textured(texture))
    });
    let ashlar = glb.texture("ashlar", &texture::ashlar(256, [214, 196, 164]));
    let tiles = texture::tiles(256, [206, 188, 158], [174, 118, 86], [120, 108, 94]);
    let court_tiles = glb.texture("court tiles", &tiles);
    let tiles = texture::tiles(256, [196, 182, 158], [140, 128, 112], [110, 102, 92]);
    let gallery_tiles = glb.texture("gallery tiles", &tiles);
    Palette {
        ashlar: glb.material(Surface::diffuse("ashlar", [1.0; 3]).textured(ashlar)),
        court_tiles: glb.material(Surface::diffuse("court tiles", [1.0; 3]).textured(court_tiles)),
        gallery_tiles: glb.material(Surface::diffuse("gallery tiles", [1.0; 3]).textured(gallery_tiles)),
        stone: glb.material(Surface::diffuse("stone", [0.70, 0.62, 0.49])),
        plaster: glb.material(Surface::diffuse("plaster", [0.74, 0.69, 0.60])),
        wood: glb.material(Surface::diffuse("wood", [0.20, 0.11, 0.055])),
        water: glb.material(Surface::diffuse("water", [0.05, 0.16, 0.19])),
        terracotta: glb.material(Surface::diffuse("terracotta", [0.50, 0.20, 0.10])),
        leaves: glb.material(Surface::diffuse("leaves", [0.09, 0.21, 0.045])),
        cloths,
    }
}
