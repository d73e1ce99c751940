//! The command line: the subcommands and their names.

use clap::{Parser, Subcommand};

use crate::commands::actions::{self, Action};
#[cfg(feature = "view")]
use crate::commands::view;
use crate::commands::{
    bake, blocklist, check, evaluate, export, fetch, fsck, inspect, list, logs, preview, priority, server,
    settings, show, site, submit, token, top, watch, worker,
};
use crate::failure::{EXIT_CODES, Result};
use crate::kinds::KindTables;

/// Bakes relightable global illumination for glTF scenes: on this machine, or on a farm over HTTP.
#[derive(Parser, Debug)]
#[command(name = "kiln", version, after_help = EXIT_CODES)]
pub struct CommandLine {
    /// The command.
    #[command(subcommand)]
    pub command: Command,
}

/// The subcommands.
#[derive(Subcommand, Debug)]
pub enum Command {
    /// Bakes a scene into a bundle
    Bake(bake::Arguments),
    /// Says what a bake of a scene would take and warn of
    Check(check::Arguments),
    /// Runs a farm's server
    Server(server::Arguments),
    /// Runs a worker for a farm's server
    Worker(worker::Arguments),
    /// Checks a farm's stored bytes
    Fsck(fsck::Arguments),
    /// Makes, lists and revokes tokens of a farm
    Token(token::Arguments),
    /// Submits a scene to a farm and prints the bake's id
    Submit(submit::Arguments),
    /// Lists a farm's bakes
    List(list::Arguments),
    /// Shows one bake
    Show(show::Arguments),
    /// Prints what happened to a bake
    Logs(logs::Arguments),
    /// Shows bakes and workers as they are now, again and again
    Top(top::Arguments),
    /// Follows a bake until it ends
    Watch(watch::Arguments),
    /// Cancels a bake
    Cancel(actions::Arguments),
    /// Holds a bake's tasks back; those under way go on
    Pause(actions::Arguments),
    /// Lets a paused bake go on
    Resume(actions::Arguments),
    /// Changes a bake's priority
    Priority(priority::Arguments),
    /// Lists workers that failed at tasks of a bake, or gives them another chance
    Blocklist(blocklist::Arguments),
    /// Deletes a bake that has ended
    Delete(actions::Arguments),
    /// Downloads a finished bake as a bundle
    Fetch(fetch::Arguments),
    /// Draws a picture of a bake
    Preview(preview::Arguments),
    /// Writes a bake's light under chosen lights for other engines: a GLB with lightmaps
    Export(export::Arguments),
    /// Writes a bake as a website of plain files, which browsers relight
    Site(site::Arguments),
    /// Opens a window on a bake: fly, move lights, change colours
    #[cfg(feature = "view")]
    View(view::Arguments),
    /// Says how right a bake is, held against a path tracer
    Evaluate(evaluate::Arguments),
    /// Says what is in a bundle or a chunk
    Inspect(inspect::Arguments),
    /// Lists every setting of a bake with its range and presets
    Settings(settings::Arguments),
}

impl Command {
    /// It goes on until somebody stops it.
    pub fn stays(&self) -> bool {
        matches!(self, Self::Server(_) | Self::Worker(_) | Self::Top(_))
    }

    /// Runs the command to its end.
    pub fn run(self, kinds: &KindTables) -> Result<()> {
        match self {
            Self::Bake(arguments) => bake::run(arguments, kinds),
            Self::Check(arguments) => check::run(arguments, kinds),
            Self::Server(arguments) => server::run(arguments, &kinds.contract),
            Self::Worker(arguments) => worker::run(arguments, &kinds.worker),
            Self::Token(arguments) => token::run(arguments),
            Self::Submit(arguments) => submit::run(arguments, kinds),
            Self::List(arguments) => list::run(arguments),
            Self::Show(arguments) => show::run(arguments),
            Self::Logs(arguments) => logs::run(arguments),
            Self::Top(arguments) => top::run(arguments),
            Self::Watch(arguments) => watch::run(arguments),
            Self::Cancel(arguments) => Action::Cancel.run(arguments),
            Self::Pause(arguments) => Action::Pause.run(arguments),
            Self::Resume(arguments) => Action::Resume.run(arguments),
            Self::Priority(arguments) => priority::run(arguments),
            Self::Blocklist(arguments) => blocklist::run(arguments),
            Self::Delete(arguments) => Action::Delete.run(arguments),
            Self::Fsck(arguments) => fsck::run(arguments),
            Self::Fetch(arguments) => fetch::run(arguments, &kinds.contract),
            Self::Preview(arguments) => preview::run(arguments, kinds),
            Self::Export(arguments) => export::run(arguments, kinds),
            Self::Site(arguments) => site::run(arguments, kinds),
            #[cfg(feature = "view")]
            Self::View(arguments) => view::run(arguments, kinds),
            Self::Evaluate(arguments) => evaluate::run(arguments, kinds),
            Self::Inspect(arguments) => inspect::run(arguments, &kinds.contract),
            Self::Settings(arguments) => settings::run(arguments, &kinds.contract),
        }
    }
}
