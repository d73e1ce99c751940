// No object changes light: stands for `passes/transfer`.

fn draw_within(index: u32) -> u32 {
    return index;
}

fn lamp_count() -> u32 {
    return light_count.count;
}

fn lamp_at(index: u32) -> Light {
    return lights[index];
}

fn find_moved(draw_index: u32, surface: Surface) {
}

fn given_about(surface: Surface, normal: vec3f) -> vec3f {
    return vec3f(0.0);
}

fn moved_by(index: u32, share: f32) -> vec3f {
    return vec3f(0.0);
}

fn changed(light: vec3f, moved: vec3f) -> vec3f {
    return light;
}
