//! Handles of lights in the picture, and the way in which they are dragged.

use glam::{Vec2, Vec3};
use lightkiln_proto::rectangle::Rectangle;
use lightkiln_proto::scene::{LightKind, SceneCamera, SceneLight};

use super::lens::{Lens, Ray};

/// Pixels around a handle in which it is taken.
const REACH: f32 = 14.0;
/// Radius of the ball that suns lie on, as a share of half the picture's height.
const BALL: f32 = 0.6;
/// Pixels from a spot to the handle of its aim.
const AIM_PIXELS: f32 = 80.0;
/// Metres along the view for a pixel of a drag with shift, in those that a pixel spans.
const ALONG: f32 = 3.0;

/// A part of a light that can be dragged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// The place of a point or a spot, the centre of a rectangle.
    Place,
    /// The direction of a spot or a rectangle.
    Aim,
    /// The direction to a sun, on a ball in the middle of the picture.
    Sun,
}

/// A handle in the picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Handle {
    /// Number of the light.
    pub light: usize,
    /// The part.
    pub part: Part,
    /// Its place.
    pub place_m: Vec3,
    /// Its pixel.
    pub pixel: Vec2,
}

/// The ball in the middle of the picture.
#[derive(Clone, Copy, Debug)]
pub struct Ball {
    /// Middle.
    pub centre_m: Vec3,
    /// Radius.
    pub radius_m: f32,
}

impl Ball {
    /// The ball before a camera, in a scene of that diagonal.
    pub fn before(camera: &SceneCamera, diagonal_m: f32) -> Self {
        let [eye, target] = [camera.eye_m, camera.target_m].map(Vec3::from);
        let distance_m = 0.1 * diagonal_m;
        let centre_m = eye + (target - eye).normalize_or(Vec3::NEG_Z) * distance_m;
        let half = camera.orthographic_half_height_m;
        let half = half.unwrap_or_else(|| distance_m * (0.5 * camera.fov_y_rad).tan());
        Self { centre_m, radius_m: BALL * half }
    }

    /// The point of the ball under a ray, on the near or the far side; at the rim, and outside, where the ray passes it.
    fn under(&self, Ray { origin_m, direction }: Ray, is_near: bool) -> (Vec3, bool) {
        let to_centre = self.centre_m - origin_m;
        let along = to_centre.dot(direction);
        let aside = origin_m + direction * along - self.centre_m;
        let depth2 = self.radius_m * self.radius_m - aside.length_squared();
        if depth2 <= 0.0 {
            return (self.centre_m + aside.normalize_or(Vec3::Y) * self.radius_m, true);
        }
        let depth = if is_near { -depth2.sqrt() } else { depth2.sqrt() };
        (self.centre_m + aside + direction * depth, false)
    }
}

/// The handles of lights that are before the camera.
pub fn handles(lights: &[SceneLight], lens: &Lens, ball: Ball) -> Vec<Handle> {
    let mut found = Vec::new();
    for (light, row) in lights.iter().enumerate() {
        let mut add = |part: Part, place_m: Vec3| {
            found.extend(lens.pixel(place_m).map(|pixel| Handle { light, part, place_m, pixel }));
        };
        match &row.kind {
            LightKind::Point { position_m, .. } => add(Part::Place, (*position_m).into()),
            LightKind::Spot { position_m, direction, .. } | LightKind::Rect { position_m, direction, .. } => {
                let place_m = Vec3::from(*position_m);
                add(Part::Place, place_m);
                let reach_m = AIM_PIXELS * lens.metres_a_pixel(place_m);
                add(Part::Aim, place_m + Vec3::from(*direction) * reach_m);
            }
            LightKind::Sun { direction } => {
                add(
                    Part::Sun,
                    ball.centre_m - Vec3::from(*direction).normalize_or(Vec3::NEG_Y) * ball.radius_m,
                );
            }
            LightKind::Sky { .. } => {}
        }
    }
    found
}

/// Those that are shown and can be taken: an aim is so with its light, when that is chosen.
pub fn shown(mut handles: Vec<Handle>, chosen: Option<usize>) -> Vec<Handle> {
    handles.retain(|handle| handle.part != Part::Aim || chosen == Some(handle.light));
    handles
}

/// Corners of a rectangle in the picture, in order around it; none for other lights, and where one is behind the eye.
pub fn outline(light: &SceneLight, lens: &Lens) -> Option<[Vec2; 4]> {
    let Rectangle { centre_m, half_u_m: u, half_v_m: v, .. } = Rectangle::of(&light.kind)?;
    let [a, b, c, d] = [-u - v, u - v, u + v, v - u].map(|corner| lens.pixel(centre_m + corner));
    Some([a?, b?, c?, d?])
}

/// The handle at a pixel.
pub fn at(handles: &[Handle], pixel: Vec2) -> Option<Handle> {
    let near = handles.iter().filter(|handle| handle.pixel.distance(pixel) <= REACH);
    near.min_by(|a, b| a.pixel.distance(pixel).total_cmp(&b.pixel.distance(pixel))).copied()
}

/// A handle in the hand.
#[derive(Clone, Copy, Debug)]
pub struct Drag {
    /// The handle as it was taken.
    pub handle: Handle,
    place_m: Vec3,
    pixel: Vec2,
    /// From the pointer to the handle: it does not jump when it is taken.
    offset: Vec2,
    is_near: bool,
    is_outside: bool,
}

impl Drag {
    /// Takes a handle at a pixel.
    pub fn take(handle: Handle, pixel: Vec2, lens: &Lens, ball: Ball) -> Self {
        let place_m = handle.place_m;
        let is_near = (place_m - ball.centre_m).dot(lens.forward()) < 0.0;
        Self { handle, place_m, pixel, offset: handle.pixel - pixel, is_near, is_outside: false }
    }

    /// Drags the handle to a pixel; `along` the view where that is asked for.
    pub fn to(&mut self, pixel: Vec2, along: bool, (lens, ball): (&Lens, Ball), light: &mut SceneLight) {
        let moved = pixel - self.pixel;
        self.pixel = pixel;
        match self.handle.part {
            Part::Sun => self.roll(pixel + self.offset, lens, ball),
            _ if along => {
                let step_m = -moved.y * ALONG * lens.metres_a_pixel(self.place_m);
                self.place_m += lens.ray(self.handle_pixel(lens, pixel)).direction * step_m;
                // From here on the handle is held where it is.
                self.offset = self.handle_pixel(lens, pixel) - pixel;
            }
            _ => self.place_m = lens.on_plane(pixel + self.offset, self.place_m).unwrap_or(self.place_m),
        }
        self.set(ball, light);
    }

    fn handle_pixel(&self, lens: &Lens, pixel: Vec2) -> Vec2 {
        lens.pixel(self.place_m).unwrap_or(pixel)
    }

    /// Over the rim of the ball and back again is on its other side.
    fn roll(&mut self, pixel: Vec2, lens: &Lens, ball: Ball) {
        let ray = lens.ray(pixel);
        let (_, is_outside) = ball.under(ray, self.is_near);
        if self.is_outside && !is_outside {
            self.is_near = !self.is_near;
        }
        self.is_outside = is_outside;
        self.place_m = ball.under(ray, self.is_near).0;
    }

    fn set(&self, ball: Ball, light: &mut SceneLight) {
        let place_m = self.place_m;
        match &mut light.kind {
            LightKind::Point { position_m, .. } => *position_m = place_m.into(),
            LightKind::Spot { position_m, .. } | LightKind::Rect { position_m, .. }
                if self.handle.part == Part::Place =>
            {
                *position_m = place_m.into()
            }
            LightKind::Spot { position_m, direction, .. } | LightKind::Rect { position_m, direction, .. } => {
                if let Some(aim) = (place_m - Vec3::from(*position_m)).try_normalize() {
                    *direction = aim.into();
                }
            }
            LightKind::Sun { direction } => {
                if let Some(from) = (ball.centre_m - place_m).try_normalize() {
                    *direction = from.into();
                }
            }
            LightKind::Sky { .. } => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lights::{parse_camera, parse_light};

    const BOUNDS: [[f32; 3]; 2] = [[-5.0; 3], [5.0; 3]];

    fn stage() -> (SceneCamera, Lens, Ball) {
        let camera = parse_camera("eye=0.5,1,6 target=0,1,0 fov=60").unwrap();
        let lens = Lens::new(&camera, [800, 600], BOUNDS).unwrap();
        let ball = Ball::before(&camera, 17.0);
        (camera, lens, ball)
    }

    fn taken(light: &SceneLight, part: Part, aside: Vec2) -> Drag {
        let (_, lens, ball) = stage();
        let all = handles(std::slice::from_ref(light), &lens, ball);
        let handle = all.iter().find(|handle| handle.part == part).unwrap();
        let pixel = handle.pixel + aside;
        assert_eq!(at(&all, pixel), Some(*handle));
        Drag::take(*handle, pixel, &lens, ball)
    }

    fn pixel_of(light: &SceneLight, part: Part) -> Vec2 {
        let (_, lens, ball) = stage();
        let all = handles(std::slice::from_ref(light), &lens, ball);
        all.iter().find(|handle| handle.part == part).unwrap().pixel
    }

    #[test]
    fn dragged_light_ends_under_the_cursor_at_its_depth() {
        let (_, lens, ball) = stage();
        for words in [
            "point pos=1,2,-1 power=5",
            "spot pos=1,2,-1 dir=0.3,-1,0.1 power=5",
            "rect pos=1,2,-1 dir=0.3,-1,0.1 size=1,0.5 power=5",
        ] {
            let mut light = parse_light(words).unwrap();
            let aside = Vec2::new(3.0, -2.0);
            let mut drag = taken(&light, Part::Place, aside);
            let depth = |light: &SceneLight| match &light.kind {
                LightKind::Point { position_m, .. }
                | LightKind::Spot { position_m, .. }
                | LightKind::Rect { position_m, .. } => Vec3::from(*position_m).dot(lens.forward()),
                _ => panic!("a place"),
            };
            let before = depth(&light);
            for to in [Vec2::new(200.0, 350.0), Vec2::new(640.0, 100.0)] {
                drag.to(to, false, (&lens, ball), &mut light);
                assert!(pixel_of(&light, Part::Place).distance(to - aside) < 0.05);
                assert!((depth(&light) - before).abs() < 1e-3);
            }
            // With shift it goes away from the eye and stays on its ray, then on from there.
            let held = pixel_of(&light, Part::Place);
            drag.to(Vec2::new(640.0, 80.0), true, (&lens, ball), &mut light);
            assert!(depth(&light) > before + 0.1 && pixel_of(&light, Part::Place).distance(held) < 0.05);
            drag.to(Vec2::new(650.0, 80.0), false, (&lens, ball), &mut light);
            assert!(pixel_of(&light, Part::Place).distance(held + Vec2::new(10.0, 0.0)) < 0.05);
        }
    }

    #[test]
    fn sun_ends_under_the_cursor_on_the_side_that_it_is_on() {
        let (_, lens, ball) = stage();
        for words in ["sun dir=0.2,-0.5,-0.8 irradiance=1", "sun dir=0.2,-0.5,0.8 irradiance=1"] {
            let mut light = parse_light(words).unwrap();
            let behind = |light: &SceneLight| match light.kind {
                LightKind::Sun { direction } => Vec3::from(direction).dot(lens.forward()) < 0.0,
                _ => panic!("a sun"),
            };
            let was = behind(&light);
            let mut drag = taken(&light, Part::Sun, Vec2::ZERO);
            let to = Vec2::new(430.0, 250.0);
            drag.to(to, false, (&lens, ball), &mut light);
            assert!(pixel_of(&light, Part::Sun).distance(to) < 0.1);
            assert_eq!(behind(&light), was);
            // Over the rim it waits there, and comes back on the other side.
            drag.to(Vec2::new(790.0, 300.0), false, (&lens, ball), &mut light);
            drag.to(to, false, (&lens, ball), &mut light);
            assert!(pixel_of(&light, Part::Sun).distance(to) < 0.1);
            assert_ne!(behind(&light), was);
        }
    }

    #[test]
    fn aim_of_a_spot_points_at_the_cursor_and_its_place_stays() {
        let (_, lens, ball) = stage();
        let mut light = parse_light("spot pos=0,1,0 dir=0,-1,0 power=5").unwrap();
        let mut drag = taken(&light, Part::Aim, Vec2::ZERO);
        let place = pixel_of(&light, Part::Place);
        drag.to(place + Vec2::new(80.0, 0.0), false, (&lens, ball), &mut light);
        assert_eq!(pixel_of(&light, Part::Place), place);
        let aim = pixel_of(&light, Part::Aim) - place;
        assert!(aim.x > 70.0 && aim.y.abs() < 3.0, "{aim}");
    }

    #[test]
    fn aims_are_there_with_lights_that_are_chosen() {
        let (_, lens, ball) = stage();
        let light = parse_light("spot pos=0,1,0 dir=0,-1,0 power=5").unwrap();
        let all = handles(&[light.clone(), light], &lens, ball);
        let aims = |chosen| -> Vec<usize> {
            let shown = shown(all.clone(), chosen);
            assert_eq!(shown.iter().filter(|handle| handle.part == Part::Place).count(), 2);
            shown.iter().filter(|handle| handle.part == Part::Aim).map(|handle| handle.light).collect()
        };
        assert_eq!(aims(None), [0; 0]);
        assert_eq!(aims(Some(1)), [1]);
    }

    #[test]
    fn outline_of_a_rectangle_has_its_corners_and_others_have_none() {
        let (_, lens, _) = stage();
        let rect = parse_light("rect pos=0,1,0 dir=0,0,1 size=1,2 power=5").unwrap();
        let corners = outline(&rect, &lens).unwrap();
        // The light shines at the eye: its right is the picture's left.
        let wanted = [[0.5, 0.0], [-0.5, 0.0], [-0.5, 2.0], [0.5, 2.0]]
            .map(|[x, y]| lens.pixel(Vec3::new(x, y, 0.0)).unwrap());
        for (corner, wanted) in corners.iter().zip(wanted) {
            assert!(corner.distance(wanted) < 0.05, "{corners:?}");
        }
        let point = parse_light("point pos=0,1,0 power=5").unwrap();
        assert_eq!(outline(&point, &lens), None);
        let behind = parse_light("rect pos=0.5,1,7 dir=0,0,1 size=1,2 power=5").unwrap();
        assert_eq!(outline(&behind, &lens), None);
    }

    #[test]
    fn nothing_is_taken_far_from_handles_and_skies_have_none() {
        let (_, lens, ball) = stage();
        let lights = ["point pos=0,1,0 power=5", "sky strength=1"].map(|words| parse_light(words).unwrap());
        let all = handles(&lights, &lens, ball);
        assert_eq!(all.len(), 1);
        assert_eq!(at(&all, all[0].pixel + Vec2::splat(30.0)), None);
    }
}
