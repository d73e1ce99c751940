// Walks of pixels; joined behind `view.wgsl`, `walk.wgsl` and `cones.wgsl`. Twin: reference.rs.

struct Pixels {
    // Of the picture, and of the walked one.
    size: vec2u,
    cells: vec2u,
    // Pixels along a side of a walked one.
    step: u32,
    // Identity of the sample.
    turn: u32,
    // Walks of each part; 0: there is none.
    reflections: u32,
    occlusion: u32,
    irradiance: u32,
    // Reach of occlusion in metres.
    reach_m: f32,
    pad: vec2u,
    world_from_clip: mat4x4f,
}

@group(1) @binding(0) var<uniform> view: ShadeView;
@group(1) @binding(1) var<uniform> pixels: Pixels;
// Points in metres, then slopes' width: 0 where all reflection is diffuse, below 0 where nothing is seen.
@group(1) @binding(2) var points: texture_2d<f32>;
// Shading normals and facets.
@group(1) @binding(3) var normals: texture_2d<u32>;
// What is reflected, then the share that is open; irradiance.
@group(1) @binding(4) var walked: texture_storage_2d_array<rgba32float, write>;

@compute @workgroup_size(8, 8)
fn walk_pixels(@builtin(global_invocation_id) cell: vec3u) {
    if any(cell.xy >= pixels.cells) {
        return;
    }
    let pixel = min(cell.xy * pixels.step, pixels.size - 1u);
    let place = textureLoad(points, pixel, 0);
    if place.w < 0.0 {
        return;
    }
    let codes = textureLoad(normals, pixel, 0).xy;
    let normal = octahedral_of(codes.x);
    let facet = octahedral_of(codes.y);
    let eye = -normalize(ray_to(view.clip_from_world * vec4f(place.xyz, 1.0)));
    let identity = pixel.x + pixels.size.x * pixel.y + pixels.turn;
    let reflections = select(0u, pixels.reflections, place.w > 0.0);
    let first_occlusion = reflections;
    let first_irradiance = reflections + pixels.occlusion;
    var reflected = vec3f(0.0);
    var irradiance = vec3f(0.0);
    var hidden = 0.0;
    for (var index = 0u; index < first_irradiance + pixels.irradiance; index++) {
        var cone = Cone(normal, 1.0);
        var reach = FAR;
        if index < first_occlusion {
            cone = reflected_cone(bundle(reflections, identity), index, normal, eye, place.w);
        } else if index < first_irradiance {
            cone = cosine_cone(bundle(pixels.occlusion, identity), index - first_occlusion, normal);
            reach = pixels.reach_m;
        } else {
            cone = cosine_cone(bundle(pixels.irradiance, identity), index - first_irradiance, normal);
        }
        cone = above(cone, facet);
        let hit = walk(place.xyz, facet, cone.direction, cone.tangent, reach);
        if index < first_occlusion {
            reflected += radiance(hit, cone.direction);
        } else if index < first_irradiance {
            let near = select(0.0, 1.0 - hit.t / pixels.reach_m, hit.element != NOTHING);
            hidden += near * near;
        } else {
            irradiance += radiance(hit, cone.direction);
        }
    }
    let open = 1.0 - hidden / f32(max(pixels.occlusion, 1u));
    textureStore(walked, cell.xy, 0, vec4f(reflected / f32(max(reflections, 1u)), open));
    if pixels.irradiance > 0u {
        textureStore(walked, cell.xy, 1, vec4f(irradiance * (PI / f32(pixels.irradiance)), 0.0));
    }
}

// What a pixel's own ray meets, with no mesh: alpha 1 on elements.
@fragment
fn seen(corner: SkyCorner) -> @location(0) vec4f {
    let at = corner.clip.xy / vec2f(pixels.size);
    let begin = pixels.world_from_clip * vec4f(2.0 * at.x - 1.0, 1.0 - 2.0 * at.y, 1.0, 1.0);
    let along = length(corner.ray);
    let direction = corner.ray / along;
    let hit = walk(begin.xyz / begin.w, vec3f(0.0), direction, 0.5 * view.ray_per_y.w / max(along, 1.0), FAR);
    return vec4f(radiance(hit, direction), select(1.0, 0.0, hit.element == NOTHING));
}
