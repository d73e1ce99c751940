//! Objects that move through bakes: what they give and take, and what they never change.

use std::path::Path;
use std::sync::Arc;

use glam::{DVec3, Vec3, Vec4};
use lightkiln_client::bake::{Beside, LoadedBake, share_colours};
use lightkiln_client::fetch::Source;
use lightkiln_client::frame::{Frame, FrameRoom};
use lightkiln_client::kinds;
use lightkiln_client::lights::{Caster, parse_camera, parse_lights};
use lightkiln_client::passes::gpu::Gpu;
use lightkiln_client::passes::shade;
use lightkiln_client::passes::shadow::ShadowRoom;
use lightkiln_client::passes::transfer::{OUTLIERS, TOLERANCE};
use lightkiln_client::preview::{Backend, LitReceivers, View, light_receivers_among, render};
use lightkiln_client::scene::{Recolour, Stance};
use lightkiln_proto::relight::Limit;
use lightkiln_proto::scene::SceneCamera;
use lightkiln_proto::transfer::{TRANSFER, decode_transfer};
use lightkiln_tests::harness::{Recipe, bake};
use lightkiln_tests::scenes::glb::Surface;
use lightkiln_tests::scenes::movers::{alone, ball, cuboid, mover};
use lightkiln_tests::scenes::{cornell_of_one_box, furnace, two_rooms};
use lightkiln_tests::studies::transfer::{Setting, measured};
use lightkiln_worker::reference::luminance;

use super::setup::with_texels;

fn object_recipe() -> Recipe {
    with_texels("transfer", 0.1, 64).with("transfer_rays", 256).with("transfer_nodes", 12)
}

fn scene_recipe(texel_m: f32) -> Recipe {
    with_texels("prt", texel_m, 64).with("voxels", "on")
}

fn loaded(folder: &Path, scene: Vec<u8>, recipe: &Recipe) -> LoadedBake {
    bake(scene, recipe).unwrap().write(folder).unwrap();
    LoadedBake::load(&Source::bundle(folder).unwrap(), &kinds::all()).unwrap()
}

fn fresh(scene: Vec<u8>, recipe: &Recipe) -> LoadedBake {
    loaded(tempfile::tempdir().unwrap().path(), scene, recipe)
}

fn at(x: f32, y: f32, z: f32) -> Stance {
    Stance { position_m: [x, y, z], ..Stance::default() }
}

/// Indirect light at receivers under a light in words, emitters at full.
fn indirect(bake: &LoadedBake, lights: &[&str], stances: &[Stance]) -> Vec<Vec4> {
    lit_by(Backend::Cpu, bake, lights, stances).settled.light.without_direct().collect()
}

fn lit_by(backend: Backend, bake: &LoadedBake, lights: &[&str], stances: &[Stance]) -> LitReceivers {
    let lights = parse_lights(lights).unwrap().lights;
    light_receivers_among(bake, lights, None, Vec::new(), stances, backend).unwrap()
}

/// A bake with objects in it.
fn with(mut bake: LoadedBake, objects: &[Arc<LoadedBake>]) -> LoadedBake {
    for object in objects {
        bake.put(Beside::Baked { name: "object".to_owned(), bake: object.clone() }).unwrap();
    }
    bake
}

/// Root mean square of the difference over the mean, of luminances.
fn apart(found: &[Vec4], wanted: &[Vec4]) -> f64 {
    let value = |light: &Vec4| luminance(light.truncate().as_dvec3());
    let squares: f64 = found.iter().zip(wanted).map(|(a, b)| (value(a) - value(b)).powi(2)).sum();
    let mean = wanted.iter().map(value).sum::<f64>() / wanted.len() as f64;
    (squares / wanted.len() as f64).sqrt() / mean
}

#[test]
fn object_of_the_furnace_changes_nothing_in_a_white_furnace() {
    let surface = || Surface::diffuse("furnace", [0.5; 3]).emitting([1.0; 3]);
    let object = Arc::new(fresh(alone("ball", &ball(0.5), surface()), &object_recipe()));
    let without = fresh(furnace(0.5, 1.0, 4.0), &scene_recipe(0.25));
    let wanted = indirect(&without, &[], &[]);
    let bake = with(without, &[object]);
    for stance in [at(0.0, 0.6, 0.0), at(-0.9, 0.02, 0.7), at(0.3, 2.9, -1.2)] {
        let found = indirect(&bake, &[], &[stance]);
        let worst = found.iter().zip(&wanted).map(|(a, b)| ((a.x - b.x) / b.x).abs()).fold(0.0, f32::max);
        println!("{:?}: apart {:.4}, at worst {worst:.4}", stance.position_m, apart(&found, &wanted));
        assert!(apart(&found, &wanted) < 0.005, "{}", apart(&found, &wanted));
        assert!(worst < 0.03, "{worst}");
    }
}

#[test]
fn object_beside_a_thin_wall_changes_nothing_beyond_it() {
    let object = Arc::new(fresh(mover("panel").unwrap(), &object_recipe()));
    for thickness_m in [0.02, 0.0] {
        let without = fresh(two_rooms(thickness_m), &scene_recipe(0.125));
        let before = indirect(&without, &[], &[at(0.0, 0.0, 0.0)][..0]);
        let receivers = |bake: &LoadedBake| -> Vec<Vec3> {
            let map = bake.light.lightmap(&bake.scene).unwrap();
            map.receivers.position_m.iter().map(|place| place.truncate()).collect()
        };
        let places = receivers(&without);
        let bake = with(without, std::slice::from_ref(&object));
        let lit_side = places.iter().zip(&before).filter(|(_, light)| light.x > 0.0).map(|(at_m, _)| at_m.x);
        let side = lit_side.fold(0.0_f32, |most, x| if x.abs() > most.abs() { x } else { most }).signum();
        // Along the wall, 2 cm before it.
        let stance = Stance { turn_deg: [90.0, 0.0, 0.0], ..at(side * (0.06 + 0.5 * thickness_m), 0.1, 0.1) };
        let after = indirect(&bake, &[], &[stance]);
        let (mut beyond, mut changed) = (0, 0);
        for ((place, before), after) in places.iter().zip(&before).zip(&after) {
            if place.x * side < -0.5 * thickness_m - 1e-4 {
                beyond += 1;
                assert_eq!(before, after, "{place}");
            } else {
                changed += usize::from(before != after);
            }
        }
        println!("{beyond} receivers beyond, {changed} changed before the wall");
        assert!(beyond > 1000 && changed > 1000, "{beyond} {changed}");
        // By pixel likewise.
        let (mut view, _) = View::of_bake(
            &bake,
            Some(parse_camera(&format!("eye={},1.6,0 target={},1.2,0 fov=90", -3.6 * side, -side)).unwrap()),
            Some(Vec::new()),
        )
        .unwrap();
        (view.width, view.height, view.samples) = (96, 64, 1);
        let dark = [at(side * 50.0, 0.0, 0.0), stance].map(|stance| {
            view.objects = vec![stance];
            render(&bake, &view, Backend::Cpu).unwrap().linear
        });
        assert_eq!(dark[0], dark[1]);
    }
}

/// Near an object its effect is nearer to paths than its absence is by half, and colours what is around it.
#[test]
fn box_and_panel_give_and_take_as_paths_do() {
    for (name, place) in [("box", [-1.0, 0.0, -1.2]), ("panel", [1.3, 0.0, -1.5])] {
        let setting = Setting {
            scene: cornell_of_one_box(),
            object: mover(name).unwrap(),
            stance: Stance { position_m: place, turn_deg: [25.0, 0.0, 0.0], ..Stance::default() },
            settings: serde_json::json!({"preset": "draft", "texel_m": 0.25, "transport_rays": 256}),
            object_settings: serde_json::json!({"preset": "draft", "texel_m": 0.1, "transport_rays": 64}),
            rel_error: 0.03,
            // Ends of hard shadows within texels of 25 cm are as wrong with an object as where it is ignored.
            lights: ["point", "sky-uniform", "emitters"].map(str::to_owned).into(),
        };
        for (light, errors) in measured(&setting).unwrap() {
            let all = [&errors.near, &errors.near_ignored, &errors.near_alone, &errors.own];
            let [own, ignored, alone, on_itself] = all.map(|judged| judged.figures.rel_rmse);
            let [energy, energy_on_itself] =
                [&errors.near, &errors.own].map(|judged| judged.figures.energy_ratio);
            println!(
                "{name} {}: {own} {ignored} {alone} {energy}, on itself {on_itself} {energy_on_itself}",
                light.name
            );
            // The error that the bake has without any object is no fault of it.
            let of_object = (own * own - alone * alone).max(0.0).sqrt();
            let of_ignoring = (ignored * ignored - alone * alone).max(0.0).sqrt();
            let most = if light.name == "emitters" { 0.2 } else { 0.35 };
            assert!(of_object < most * of_ignoring, "{name} {}: {of_object} {of_ignoring}", light.name);
            assert!((0.95..1.05).contains(&energy), "{}: {energy}", light.name);
        }
    }
}

#[test]
fn halves_of_a_box_change_what_the_whole_does() {
    let surface = || Surface::diffuse("box", [0.6, 0.2, 0.1]);
    let half = |x: f32| cuboid(Vec3::new(x, 0.5, 0.0), Vec3::new(0.6, 1.0, 1.0));
    let whole = cuboid(Vec3::new(0.0, 0.5, 0.0), Vec3::new(1.2, 1.0, 1.0));
    let [whole, left, right] = [whole, half(-0.3), half(0.3)]
        .map(|mesh| Arc::new(fresh(alone("box", &mesh, surface()), &object_recipe())));
    let scene = || fresh(cornell_of_one_box(), &scene_recipe(0.25));
    let place = at(1.0, 0.0, -1.6);
    let [one, two] = [with(scene(), &[whole]), with(scene(), &[left, right])].map(|bake| {
        indirect(&bake, &["sky horizon=2,2,2 zenith=2,2,2"], &[place, place][..bake.movers.len()])
    });
    let without = indirect(&scene(), &["sky horizon=2,2,2 zenith=2,2,2"], &[]);
    println!("apart {:.4}, left out {:.4}", apart(&two, &one), apart(&without, &one));
    assert!(apart(&two, &one) < 0.03 && apart(&without, &one) > 0.1, "{}", apart(&two, &one));
}

/// However many objects touch each other, light is never negative, and stays below that without them where they are black.
#[test]
fn ten_black_balls_in_a_heap_take_no_more_than_there_is() {
    let black = Surface::diffuse("soot", [0.0; 3]);
    let object = Arc::new(fresh(alone("ball", &ball(0.4), black), &object_recipe()));
    let without = fresh(cornell_of_one_box(), &scene_recipe(0.25));
    let before = indirect(&without, &["sky horizon=1,1,1 zenith=1,1,1"], &[]);
    let bake = with(without, &vec![object; 10]);
    let heap = |index: usize| {
        at(0.9 + 0.5 * (index % 3) as f32, 0.7 * (index / 6) as f32, -2.0 + 0.6 * (index / 3 % 2) as f32)
    };
    let stances: Vec<Stance> = (0..10).map(heap).collect();
    let after = indirect(&bake, &["sky horizon=1,1,1 zenith=1,1,1"], &stances);
    assert!(after.iter().all(|light| light.min_element() >= 0.0 && light.is_finite()));
    let sum = |light: &[Vec4]| light.iter().map(|light| luminance(light.truncate().as_dvec3())).sum::<f64>();
    println!("left {:.3}", sum(&after) / sum(&before));
    assert!(sum(&after) < 0.95 * sum(&before));
}

/// Volumes hang on shape alone: another colour, and other threads, give the same codes.
#[test]
fn volumes_have_no_colour_and_the_same_bytes_on_any_number_of_threads() {
    let of = |albedo: [f32; 3], threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let scene = alone("ball", &ball(0.5), Surface::diffuse("ball", albedo));
        pool.install(|| bake(scene, &object_recipe())).unwrap()
    };
    let [white, grey, again] =
        [([0.9; 3], 2), ([0.2; 3], 1), ([0.9; 3], 1)].map(|(albedo, threads)| of(albedo, threads));
    assert_eq!(white.manifest_bytes, again.manifest_bytes);
    let volumes = |bake: &lightkiln_tests::harness::LocalBake| -> Vec<_> {
        let chunks = bake.manifest.chunks(TRANSFER).iter();
        chunks.map(|chunk| decode_transfer(&bake.chunk(chunk.digest).unwrap()).unwrap()).collect()
    };
    let found = volumes(&white);
    assert_eq!(found, volumes(&grey));
    assert_eq!(found.iter().map(|level| level.level).collect::<Vec<_>>(), [3, 2, 1, 0]);
    assert_ne!(white.manifest_bytes, grey.manifest_bytes);
    // A ball is seen as π sin²α, from each node outside it.
    for level in &found {
        let lattice = lightkiln_proto::transfer::Lattice::new(level.box_m, level.level, level.nodes);
        let (mut worst, is_read) = (0.0_f32, lattice.read_nodes(level.level));
        for (node, is_read) in is_read.iter().enumerate() {
            let away_m = lattice.node_m(node).distance(lattice.middle_m);
            if away_m < 0.52 || !is_read {
                continue;
            }
            let sum = |part: usize| {
                let code = level.codes_of(part)[node].map(f32::from);
                Vec3::new(code[0], code[1], code[2]) * level.parts[part].steps[0]
            };
            let vector: Vec3 = (0..level.parts.len()).map(sum).sum();
            let wanted = std::f32::consts::PI * (0.5 / away_m).powi(2);
            worst = worst.max((vector.length() - wanted).abs());
        }
        println!("level {}: {} parts, worst {worst:.4}", level.level, level.parts.len());
        assert!(worst < 0.1, "{worst}");
    }
}

/// Place in a picture of a point, in pixels.
fn pixel_of(camera: &SceneCamera, [width, height]: [u32; 2], at_m: Vec3) -> Option<[usize; 2]> {
    let (eye, target) = (Vec3::from(camera.eye_m), Vec3::from(camera.target_m));
    let forward = (target - eye).normalize();
    let right = forward.cross(camera.up.into()).normalize();
    let way = at_m - eye;
    let scale = 0.5 * height as f32 / ((0.5 * camera.fov_y_rad).tan() * way.dot(forward));
    let x = 0.5 * width as f32 + way.dot(right) * scale;
    let y = 0.5 * height as f32 - way.dot(right.cross(forward)) * scale;
    let is_inside = x >= 1.0 && y >= 1.0 && x < width as f32 - 1.0 && y < height as f32 - 1.0;
    is_inside.then_some([x as usize, y as usize])
}

/// A picture reads what receivers are told: an object's effect is counted once, and its own surfaces are lit.
#[test]
fn pixels_and_receivers_see_the_same_effect_and_the_object_is_lit() {
    let object = Arc::new(fresh(mover("box").unwrap(), &object_recipe()));
    let bake = with(fresh(cornell_of_one_box(), &scene_recipe(0.25)), &[object]);
    let light = ["sky horizon=2,2,2 zenith=2,2,2"];
    let stances = [at(0.9, 0.0, -1.6), at(40.0, 0.0, 0.0)];
    let camera = parse_camera("eye=0.9,5.2,1.9 target=0.9,0,-1.0 fov=65").unwrap();
    let lights = parse_lights(&light).unwrap().lights;
    let (mut view, _) = View::of_bake(&bake, Some(camera.clone()), Some(lights)).unwrap();
    (view.width, view.height, view.samples) = (240, 180, 1);
    let pictures = stances.map(|stance| {
        view.objects = vec![stance];
        render(&bake, &view, Backend::Cpu).unwrap().linear
    });
    let value = |rgb: &[f32; 3]| luminance(DVec3::from(rgb.map(f64::from)));
    let is_red = |rgb: &&[f32; 3]| rgb[0] > 2.0 * rgb[2] && value(rgb) > 0.02;
    let red = pictures[0].iter().filter(is_red).count();
    assert!(red > 1000, "{red} pixels of the box are lit");
    // On the floor in front of the box, where it hides much of the back wall and nothing hides the floor.
    let of_receivers = stances.map(|stance| indirect(&bake, &light, &[stance]));
    let map = bake.light.lightmap(&bake.scene).unwrap();
    let (mut by_receivers, mut by_pixels, mut before, mut count) = (0.0, 0.0, 0.0, 0);
    for (slot, place) in map.receivers.position_m.iter().enumerate() {
        let is_there =
            place.y.abs() < 1e-4 && (-0.9..-0.3).contains(&place.z) && (0.1..1.7).contains(&place.x);
        let Some([x, y]) = pixel_of(&camera, [240, 180], place.truncate()).filter(|_| is_there) else {
            continue;
        };
        let irradiance = |picture: &[[f32; 3]]| {
            let rgb = Vec3::from(picture[y * 240 + x]);
            let albedo = map.receivers.albedo[slot].truncate();
            luminance((rgb / albedo * std::f32::consts::PI).as_dvec3())
        };
        let light = |which: usize| luminance(of_receivers[which][slot].truncate().as_dvec3());
        by_receivers += light(1) - light(0);
        by_pixels += irradiance(&pictures[1]) - irradiance(&pictures[0]);
        before += light(1);
        count += 1;
    }
    let ratio = by_pixels / by_receivers;
    println!(
        "{red} red pixels; {count} receivers lose {:.3} of their light, pixels {ratio:.3} of that",
        by_receivers / before
    );
    assert!(count > 10 && by_receivers > 0.05 * before, "{count} {by_receivers} {before}");
    assert!((0.9..1.1).contains(&ratio), "{ratio}");
}

/// Both draw objects that are lit by the room and by each other, one of them so long that it is lit from eight places; what objects a few
/// centimetres away change is told apart.
#[test]
fn adapter_lights_objects_as_the_processor_does() {
    let object = |name: &str| Arc::new(fresh(mover(name).unwrap(), &object_recipe()));
    let objects = [object("box"), object("ball")];
    for kind in ["prt", "grid"] {
        let recipe = with_texels(kind, 0.25, 64).with("voxels", "on");
        let bake = with(fresh(cornell_of_one_box(), &recipe), &objects);
        let light = ["point pos=0.3,3.4,0.5 power=60", "sky horizon=2,2,2 zenith=1,1,2"];
        let turned = Stance { turn_deg: [35.0, 0.0, 10.0], ..at(0.9, 0.2, -1.4) };
        let stances = [turned, Stance { scale: 0.35, ..at(-0.2, 0.0, 0.4) }];
        let aside = [Stance { position_m: [0.95, 0.2, -1.4], ..turned }, stances[1]];
        let lit = [Backend::Gpu, Backend::Cpu].map(|backend| lit_by(backend, &bake, &light, &stances));
        let [adapter, processor] =
            lit.each_ref().map(|lit| lit.settled.light.without_direct().collect::<Vec<Vec4>>());
        for (adapter, processor) in lit[0].objects.iter().zip(&lit[1].objects) {
            let [adapter, processor] =
                [adapter, processor].map(|own| own.without_direct().collect::<Vec<_>>());
            let same = apart(&adapter, &processor);
            println!("{kind}, receivers of an object: apart {same:.5}");
            assert!(same < TOLERANCE && adapter.len() > 100, "{same}");
        }
        assert_eq!(lit.each_ref().map(|lit| lit.objects.len()), [2, 2]);
        let other = apart(&indirect(&bake, &light, &aside), &processor);
        let far = indirect(&bake, &light, &[at(60.0, 0.0, 0.0), at(80.0, 0.0, 0.0)]);
        let (far, same) = (apart(&far, &processor), apart(&adapter, &processor));
        println!("{kind}, receivers: apart {same:.5}, without objects {far:.4}, 5 cm aside {other:.4}");
        assert!(same < TOLERANCE && other > 2.5 * TOLERANCE && far > 0.05, "{same} {other} {far}");
        let camera = parse_camera("eye=0,3,6 target=0.2,1,-1 fov=50").unwrap();
        let lights = parse_lights(&light).unwrap().lights;
        let (mut view, _) = View::of_bake(&bake, Some(camera), Some(lights)).unwrap();
        (view.width, view.height, view.samples) = (240, 180, 1);
        let mut picture = |backend: Backend, stances: [Stance; 2]| {
            view.objects = stances.to_vec();
            let linear = render(&bake, &view, backend).unwrap().linear;
            linear.iter().map(|rgb| Vec3::from(*rgb).extend(0.0)).collect::<Vec<Vec4>>()
        };
        let [adapter, processor] = [Backend::Gpu, Backend::Cpu].map(|backend| picture(backend, stances));
        let other = picture(Backend::Cpu, aside);
        let mean = processor.iter().map(|rgb| rgb.element_sum()).sum::<f32>() / processor.len() as f32;
        let off = |picture: &[Vec4]| {
            let is_off = |(one, other): &(&Vec4, &Vec4)| {
                (**one - **other).abs().element_sum() > shade::TOLERANCE * mean
            };
            picture.iter().zip(&processor).filter(is_off).count() as f64 / processor.len() as f64
        };
        println!("{kind}, pixels: {:.5} off, 5 cm aside {:.4}", off(&adapter), off(&other));
        assert!(
            off(&adapter) < OUTLIERS && off(&other) > 5.0 * OUTLIERS,
            "{} {}",
            off(&adapter),
            off(&other)
        );
    }
}

/// A frame that stays draws an object that moved as a new one does, has settled when the object has, and is black at once when lights go out.
#[test]
fn frame_goes_on_with_an_object_that_moves_and_is_black_without_light() {
    let object = Arc::new(fresh(mover("box").unwrap(), &object_recipe()));
    let bake = with(fresh(cornell_of_one_box(), &scene_recipe(0.25)), &[object]);
    let gpu = Gpu::open().unwrap();
    let lights = parse_lights(&["point pos=0.3,3.4,0.5 power=60"]).unwrap().lights;
    let camera = parse_camera("eye=0,3,6 target=0.2,1,-1 fov=50").unwrap();
    let shadows = ShadowRoom::for_lights(&Caster::of(&lights), 512).unwrap();
    let room = FrameRoom { size: [120, 90], shadows };
    let limit = Limit { change_max: 1e-4, ..Limit::default() };
    let [away, near] = [at(40.0, 0.0, 0.0), at(0.9, 0.0, -1.4)];
    let drawn = |stances: &[Stance]| {
        let mut frame = Frame::new(&gpu, &bake, room, camera.clone()).unwrap();
        frame.set_emitters(&[0.0]).unwrap();
        frame.set_lights(&lights).unwrap();
        for stance in stances {
            frame.set_objects(std::slice::from_ref(stance)).unwrap();
            let (bounces, converged) = frame.settle(limit).unwrap();
            assert!(converged && bounces > 3, "{bounces}");
            // Whoever reads light at receivers takes nothing from the next picture.
            frame.read_receivers().unwrap().unwrap();
            frame.draw([0.0; 2]).unwrap();
        }
        let picture = frame.read().unwrap();
        (frame, picture)
    };
    let (mut frame, moved) = drawn(&[away, near]);
    let (_, anew) = drawn(&[near]);
    let (_, elsewhere) = drawn(&[away]);
    println!("moved {:.5}, elsewhere {:.3}", apart(&moved, &anew), apart(&elsewhere, &anew));
    assert!(apart(&moved, &anew) < 1e-3, "{}", apart(&moved, &anew));
    assert!(apart(&elsewhere, &anew) > 0.1, "{}", apart(&elsewhere, &anew));
    frame.set_lights(&[]).unwrap();
    let (bounces, converged) = frame.settle(limit).unwrap();
    assert!(converged && bounces < 4, "{bounces}");
    let light = frame.read_receivers().unwrap().unwrap();
    assert!(light.indirect.iter().all(|light| *light == Vec4::ZERO), "light that nothing sends");
}

/// A colour that is given to an object while it stands there changes its light and that of the room as a bake of the object in that colour does.
#[test]
fn object_of_another_colour_is_as_one_baked_in_it() {
    let of = |albedo: [f32; 3]| {
        let surface = Surface::diffuse("paint", albedo);
        Arc::new(fresh(alone("ball", &ball(0.5), surface), &object_recipe()))
    };
    let bake = |object| with(fresh(cornell_of_one_box(), &scene_recipe(0.25)), &[object]);
    let [black, blue] = [[0.02; 3], [0.1, 0.2, 0.9]];
    let [plain, anew] = [bake(of(black)), bake(of(blue))];
    let gpu = Gpu::open().unwrap();
    let lights = parse_lights(&["point pos=0.3,3.4,0.5 power=60"]).unwrap().lights;
    let camera = parse_camera("eye=0,3,6 target=0.2,1,-1 fov=50").unwrap();
    let shadows = ShadowRoom::for_lights(&Caster::of(&lights), 512).unwrap();
    let colour = Recolour { material: "paint".to_owned(), base_colour: blue };
    let drawn = |bake: &LoadedBake, colours: &[Recolour]| {
        let room = FrameRoom { size: [120, 90], shadows };
        let mut frame = Frame::new(&gpu, bake, room, camera.clone()).unwrap();
        frame.set_lights(&lights).unwrap();
        frame.set_objects(&[at(0.6, 0.55, -0.8)]).unwrap();
        let limit = Limit { change_max: 1e-4, ..Limit::default() };
        frame.settle(limit).unwrap();
        frame.set_materials(colours).unwrap();
        frame.settle(limit).unwrap();
        frame.draw([0.0; 2]).unwrap();
        let receivers = frame.read_receivers().unwrap().unwrap().indirect;
        (frame.read().unwrap(), receivers)
    };
    let sum = |light: &[Vec4]| light.iter().map(|light| f64::from(light.z)).sum::<f64>();
    let (before, of_before) = drawn(&plain, &[]);
    let (edited, of_edited) = drawn(&plain, std::slice::from_ref(&colour));
    let (wanted, of_wanted) = drawn(&anew, &[]);
    println!("edited {:.5}, as before {:.4}", apart(&edited, &wanted), apart(&before, &wanted));
    assert!(apart(&edited, &wanted) < 5e-3 && apart(&before, &wanted) > 0.05);
    let [was, is, wanted] = [&of_before, &of_edited, &of_wanted].map(|light| sum(light));
    assert!((is / wanted - 1.0).abs() < 2e-3 && (was / wanted - 1.0).abs() > 0.01, "{was} {is} {wanted}");
    // The processor takes it before the object is put beside the bake.
    let mut objects = [Beside::Baked { name: "ball".to_owned(), bake: of(black) }];
    let mut room = fresh(cornell_of_one_box(), &scene_recipe(0.25));
    let own = share_colours(&room.scene.manifest, &mut objects, std::slice::from_ref(&colour)).unwrap();
    assert!(own.is_empty());
    let [object] = objects;
    room.put(object).unwrap();
    let light = ["point pos=0.3,3.4,0.5 power=60"];
    let [edited, anew] = [&room, &anew].map(|bake| indirect(bake, &light, &[at(0.6, 0.55, -0.8)]));
    assert!(apart(&edited, &anew) < 5e-3, "{}", apart(&edited, &anew));
    let other = Recolour { material: "nothing".to_owned(), ..colour };
    let refused = share_colours(&room.scene.manifest, &mut [], &[other]).unwrap_err().to_string();
    assert!(refused.contains("'nothing'"), "{refused}");
}

/// A closed ball of two sides is as one of one: its inner side, which nothing sees, takes no part.
#[test]
fn inside_of_a_double_sided_ball_takes_no_part() {
    let of = |surface: Surface| Arc::new(fresh(alone("ball", &ball(0.5), surface), &object_recipe()));
    let surface = || Surface::diffuse("ball", [0.2, 0.3, 0.6]);
    let scene = || fresh(cornell_of_one_box(), &scene_recipe(0.25));
    let light = ["sky horizon=2,2,2 zenith=2,2,2"];
    let [one, two] = [surface(), surface().double_sided()]
        .map(|surface| indirect(&with(scene(), &[of(surface)]), &light, &[at(0.9, 0.0, -1.4)]));
    let without = indirect(&scene(), &light, &[]);
    let sum = |light: &[Vec4]| light.iter().map(|light| luminance(light.truncate().as_dvec3())).sum::<f64>();
    let [taken_by_one, taken_by_two] = [&one, &two].map(|light| 1.0 - sum(light) / sum(&without));
    println!("taken {taken_by_one:.4} {taken_by_two:.4}");
    println!("apart {:.4}, without {:.4}", apart(&two, &one), apart(&without, &one));
    assert!(apart(&two, &one) < 0.15 * apart(&without, &one), "{}", apart(&two, &one));
}

/// A rug takes the light of the floor under it and gives its own: its viewpoints are not in the floor. A box sunk into the floor is lit by the room
/// alone.
#[test]
fn rug_and_a_sunken_box_are_lit_by_what_is_above_the_floor() {
    let scene = || fresh(cornell_of_one_box(), &scene_recipe(0.25));
    let light = ["sky horizon=2,2,2 zenith=2,2,2"];
    let surface = || Surface::diffuse("thing", [0.5; 3]);
    let seen = |mesh: &lightkiln_tests::scenes::mesh::Mesh, y: f32| {
        let object = Arc::new(fresh(alone("thing", mesh, surface().double_sided()), &object_recipe()));
        let bake = with(scene(), &[object]);
        let camera = parse_camera("eye=0.9,4.5,-1.0 target=0.9,0,-1.3 fov=20").unwrap();
        let lights = parse_lights(&light).unwrap().lights;
        let (mut view, _) = View::of_bake(&bake, Some(camera), Some(lights)).unwrap();
        (view.width, view.height, view.samples, view.objects) = (32, 24, 1, vec![at(0.9, y, -1.3)]);
        let linear = render(&bake, &view, Backend::Cpu).unwrap().linear;
        let middle = linear[12 * 32 + 16];
        luminance(DVec3::from(middle.map(f64::from)))
    };
    let mut rug = lightkiln_tests::scenes::mesh::Mesh::default();
    rug.rectangle(Vec3::new(-0.8, 0.0, 0.8), Vec3::X * 1.6, Vec3::Z * -1.6);
    let sunken = cuboid(Vec3::new(0.0, 0.0, 0.0), Vec3::new(1.6, 0.8, 1.6));
    let lifted = seen(&rug, 0.4);
    let [on_floor, sunk] = [seen(&rug, 0.004), seen(&sunken, 0.0)];
    println!("rug at 40 cm {lifted:.4}, on the floor {on_floor:.4}, top of a sunken box {sunk:.4}");
    assert!(on_floor > 0.8 * lifted && on_floor < 1.2 * lifted, "{on_floor} {lifted}");
    assert!(sunk > 0.8 * lifted && sunk < 1.2 * lifted, "{sunk} {lifted}");
}
