//! Keys and pointer as the viewer takes them, from wherever they come.

use glam::Vec2;
use winit::event::{ElementState, MouseButton, MouseScrollDelta, WindowEvent};
use winit::keyboard::{KeyCode, PhysicalKey};

/// Pixels of a touch pad that count as a notch of a wheel.
const PIXELS_A_NOTCH: f32 = 50.0;

/// Something that the user did in the picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Input {
    /// A key went down or up.
    Key(Key, bool),
    /// The pointer is at these pixels from the upper left corner.
    Pointer(Vec2),
    /// A button went down or up.
    Button(Button, bool),
    /// The wheel turned by so many notches, away from the user.
    Wheel(f32),
    /// Whatever is down goes up: the window lost the keyboard.
    Release,
}

/// Keys that do something.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Key {
    /// W: forward.
    Forward,
    /// S: back.
    Back,
    /// A: left.
    Left,
    /// D: right.
    Right,
    /// E: up.
    Up,
    /// Q: down.
    Down,
    /// Shift: faster; of a light, along the view.
    Shift,
    /// Home: the bake's camera.
    Home,
    /// Delete: the chosen light goes.
    Delete,
    /// F1: the panel comes and goes.
    Panel,
    /// F12: a picture is written.
    Picture,
}

/// Buttons of a mouse.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Button {
    /// Left: takes a handle.
    Left,
    /// Right: looks around.
    Right,
}

impl Input {
    /// Meaning of a window's event to the viewer, if it has one. Keys are those of their places, whatever is printed on them.
    pub fn of(event: &WindowEvent) -> Option<Self> {
        match event {
            WindowEvent::KeyboardInput { event, is_synthetic, .. } => {
                let PhysicalKey::Code(code) = event.physical_key else { return None };
                let is_down = event.state == ElementState::Pressed;
                Self::of_key(Key::of(code)?, is_down, event.repeat || *is_synthetic)
            }
            WindowEvent::CursorMoved { position, .. } => {
                Some(Self::Pointer(Vec2::new(position.x as f32, position.y as f32)))
            }
            WindowEvent::MouseInput { state, button, .. } => {
                let button = match button {
                    MouseButton::Left => Button::Left,
                    MouseButton::Right => Button::Right,
                    _ => return None,
                };
                Some(Self::Button(button, *state == ElementState::Pressed))
            }
            WindowEvent::MouseWheel { delta, .. } => Some(Self::Wheel(match delta {
                MouseScrollDelta::LineDelta(_, lines) => *lines,
                MouseScrollDelta::PixelDelta(pixels) => pixels.y as f32 / PIXELS_A_NOTCH,
            })),
            WindowEvent::Focused(false) => Some(Self::Release),
            _ => None,
        }
    }

    /// A key as the viewer takes it. A press that only says that it is still down does nothing once more.
    fn of_key(key: Key, is_down: bool, is_still: bool) -> Option<Self> {
        let is_once = matches!(key, Key::Panel | Key::Picture | Key::Delete);
        (!(is_down && is_still && is_once)).then_some(Self::Key(key, is_down))
    }

    /// Something ends: it counts even where the panel has keyboard and pointer.
    pub fn ends(&self) -> bool {
        matches!(self, Self::Key(_, false) | Self::Button(_, false) | Self::Release)
    }
}

impl Key {
    fn of(code: KeyCode) -> Option<Self> {
        Some(match code {
            KeyCode::KeyW => Self::Forward,
            KeyCode::KeyS => Self::Back,
            KeyCode::KeyA => Self::Left,
            KeyCode::KeyD => Self::Right,
            KeyCode::KeyE => Self::Up,
            KeyCode::KeyQ => Self::Down,
            KeyCode::ShiftLeft | KeyCode::ShiftRight => Self::Shift,
            KeyCode::Home => Self::Home,
            KeyCode::Delete => Self::Delete,
            KeyCode::F1 => Self::Panel,
            KeyCode::F12 => Self::Picture,
            _ => return None,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_that_are_held_do_once_what_they_do_and_fly_on() {
        for key in [Key::Panel, Key::Picture, Key::Delete] {
            assert_eq!(Input::of_key(key, true, false), Some(Input::Key(key, true)));
            assert_eq!(Input::of_key(key, true, true), None);
            assert_eq!(Input::of_key(key, false, true), Some(Input::Key(key, false)));
        }
        assert_eq!(Input::of_key(Key::Forward, true, true), Some(Input::Key(Key::Forward, true)));
    }
}
