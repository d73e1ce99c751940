//! The camera that flies.

use std::collections::BTreeSet;

use glam::{Quat, Vec2, Vec3};
use lightkiln_proto::scene::SceneCamera;

use super::input::Key;

/// Share of the scene's diagonal that a second of flight goes.
const SPEED: f32 = 0.12;
/// Factor of the shift key.
const FASTER: f32 = 4.0;
/// Factor of a notch of the wheel.
const NOTCH: f32 = 1.25;
/// Bounds of the speed, in diagonals a second.
const SPEEDS: [f32; 2] = [1e-4, 10.0];
/// Radians that a pixel of the mouse turns.
const RADIANS_A_PIXEL: f32 = 0.004;
/// Largest sine of the view's slope: straight up has no upright.
const SLOPE_MAX: f32 = 0.9995;
/// Longest step: a slow picture is no leap.
const STEP_MAX_SECS: f32 = 0.25;

/// A camera with the keys that move it.
#[derive(Clone, Debug)]
pub struct Fly {
    home: SceneCamera,
    camera: SceneCamera,
    diagonal_m: f32,
    /// Diagonals a second.
    speed: f32,
    down: BTreeSet<Key>,
}

impl Fly {
    /// Stands at `home`, in a scene of that diagonal.
    pub fn new(home: SceneCamera, diagonal_m: f32) -> Self {
        let camera = home.clone();
        Self { home, camera, diagonal_m, speed: SPEED, down: BTreeSet::new() }
    }

    /// The camera as it is.
    pub fn camera(&self) -> &SceneCamera {
        &self.camera
    }

    /// Metres a second.
    pub fn speed_m(&self) -> f32 {
        self.speed * self.diagonal_m
    }

    /// A key went down or up.
    pub fn key(&mut self, key: Key, is_down: bool) {
        if !is_down {
            self.down.remove(&key);
        } else if key == Key::Home {
            self.camera = self.home.clone();
        } else {
            self.down.insert(key);
        }
    }

    /// Whether a key is down.
    pub fn holds(&self, key: Key) -> bool {
        self.down.contains(&key)
    }

    /// All keys go up.
    pub fn release(&mut self) {
        self.down.clear();
    }

    /// The wheel changes the speed.
    pub fn wheel(&mut self, notches: f32) {
        if notches.is_finite() {
            self.speed = (self.speed * NOTCH.powf(notches)).clamp(SPEEDS[0], SPEEDS[1]);
        }
    }

    /// The mouse looks around: right and down are positive.
    pub fn look(&mut self, pixels: Vec2) {
        let (eye, up) = (Vec3::from(self.camera.eye_m), Vec3::from(self.home.up).normalize_or(Vec3::Y));
        let ahead = Vec3::from(self.camera.target_m) - eye;
        let forward = ahead.normalize_or(Vec3::NEG_Z);
        let turned = Quat::from_axis_angle(up, -pixels.x * RADIANS_A_PIXEL) * forward;
        let right = turned.cross(up).normalize_or(Vec3::X);
        let tilted = Quat::from_axis_angle(right, -pixels.y * RADIANS_A_PIXEL) * turned;
        // A camera that is steeper, as a bake's may be, can only become less so.
        let slope = tilted.dot(up).abs();
        let is_level = slope < SLOPE_MAX || slope < turned.dot(up).abs();
        // Beyond the zenith the picture would stand on its head.
        let is_upright = is_level && tilted.cross(up).dot(right) > 0.0;
        let forward = if is_upright { tilted } else { turned };
        self.camera.target_m = (eye + forward * ahead.length()).into();
    }

    /// Flies for so many seconds; whether anything moved.
    pub fn step(&mut self, seconds: f32) -> bool {
        let (eye, target) = (Vec3::from(self.camera.eye_m), Vec3::from(self.camera.target_m));
        let up = Vec3::from(self.home.up).normalize_or(Vec3::Y);
        let forward = (target - eye).normalize_or(Vec3::NEG_Z);
        let right = forward.cross(up).normalize_or(Vec3::X);
        let along = |ahead: Key, back: Key| {
            f32::from(u8::from(self.holds(ahead))) - f32::from(u8::from(self.holds(back)))
        };
        let direction = forward * along(Key::Forward, Key::Back)
            + right * along(Key::Right, Key::Left)
            + up * along(Key::Up, Key::Down);
        let Some(direction) = direction.try_normalize() else { return false };
        let faster = if self.holds(Key::Shift) { FASTER } else { 1.0 };
        let step = direction * self.speed_m() * faster * seconds.clamp(0.0, STEP_MAX_SECS);
        if !(eye + step).is_finite() {
            return false;
        }
        self.camera.eye_m = (eye + step).into();
        self.camera.target_m = (target + step).into();
        true
    }

    /// Whether keys are down that fly.
    pub fn is_flying(&self) -> bool {
        let keys = [Key::Forward, Key::Back, Key::Left, Key::Right, Key::Up, Key::Down];
        keys.iter().any(|key| self.holds(*key))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fly() -> Fly {
        let home = SceneCamera {
            name: "home".to_owned(),
            eye_m: [0.0, 1.0, 5.0],
            target_m: [0.0, 1.0, 0.0],
            up: [0.0, 1.0, 0.0],
            fov_y_rad: 0.8,
            orthographic_half_height_m: None,
        };
        Fly::new(home, 10.0)
    }

    fn forward(fly: &Fly) -> Vec3 {
        (Vec3::from(fly.camera().target_m) - Vec3::from(fly.camera().eye_m)).normalize()
    }

    #[test]
    fn keys_move_along_the_view_and_across_it() {
        let cases = [
            (Key::Forward, Vec3::NEG_Z),
            (Key::Back, Vec3::Z),
            (Key::Right, Vec3::X),
            (Key::Left, Vec3::NEG_X),
            (Key::Up, Vec3::Y),
            (Key::Down, Vec3::NEG_Y),
        ];
        for (key, direction) in cases {
            let mut fly = fly();
            assert!(!fly.step(0.1));
            fly.key(key, true);
            assert!(fly.step(0.1));
            let moved = Vec3::from(fly.camera().eye_m) - Vec3::new(0.0, 1.0, 5.0);
            assert!(moved.distance(direction * 0.1 * SPEED * 10.0) < 1e-5, "{key:?}: {moved}");
            assert_eq!(forward(&fly), Vec3::NEG_Z);
            fly.key(key, false);
            assert!(!fly.step(0.1), "{key:?}");
        }
    }

    #[test]
    fn shift_and_wheel_make_it_faster_and_a_long_picture_is_no_leap() {
        let gone = |change: fn(&mut Fly), seconds: f32| {
            let mut fly = fly();
            change(&mut fly);
            fly.key(Key::Forward, true);
            fly.step(seconds);
            5.0 - fly.camera().eye_m[2]
        };
        let plain = gone(|_| {}, 0.1);
        assert!((gone(|fly| fly.key(Key::Shift, true), 0.1) / plain - FASTER).abs() < 1e-3);
        assert!((gone(|fly| fly.wheel(2.0), 0.1) / plain - NOTCH * NOTCH).abs() < 1e-3);
        assert!((gone(|_| {}, 60.0) - gone(|_| {}, STEP_MAX_SECS)).abs() < 1e-6);
        assert!(gone(|fly| fly.wheel(1e9), 0.1).is_finite());
        assert_eq!(gone(|fly| fly.wheel(f32::NAN), 0.1), plain);
    }

    #[test]
    fn mouse_turns_the_view_and_never_upside_down() {
        let mut fly = fly();
        fly.look(Vec2::new(100.0, 0.0));
        assert!(forward(&fly).x > 0.3 && forward(&fly).y.abs() < 1e-5, "{}", forward(&fly));
        for _ in 0..100 {
            fly.look(Vec2::new(0.0, -40.0));
        }
        assert!(forward(&fly).y > 0.9 && forward(&fly).y < 1.0, "{}", forward(&fly));
        fly.look(Vec2::new(0.0, 5000.0));
        assert!(forward(&fly).is_finite());
        assert_eq!(fly.camera().eye_m, [0.0, 1.0, 5.0]);
        fly.key(Key::Home, true);
        assert_eq!(*fly.camera(), fly.home);
    }

    #[test]
    fn camera_that_looks_straight_down_or_up_can_look_away() {
        for (ahead, pixels) in [(-5.0, -2.0), (5.0, 2.0)] {
            let home = SceneCamera { target_m: [0.0, 1.0 + ahead, 5.0], ..fly().home };
            let mut fly = Fly::new(home, 10.0);
            fly.look(Vec2::new(0.0, -pixels));
            assert_eq!(forward(&fly).y.abs(), 1.0, "over the head it stays");
            for _ in 0..100 {
                fly.look(Vec2::new(0.0, pixels));
            }
            assert!(forward(&fly).y.abs() < 0.8, "{}", forward(&fly));
        }
    }

    #[test]
    fn keys_go_up_when_the_window_is_left() {
        let mut fly = fly();
        fly.key(Key::Forward, true);
        assert!(fly.is_flying());
        fly.release();
        assert!(!fly.is_flying() && !fly.step(0.1));
    }
}
