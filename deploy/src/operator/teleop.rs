//! `zenav teleop`. Drives a robot from a terminal: keys in, twists out twenty times a second, each echoing the newest stamp received from
//! the robot. If the link or this program freezes, the echo grows old and the robot brakes by itself.
//!
//! Leaving by Ctrl-C, a closed terminal or a failure always leaves the robot stopped until `zenav resume`. Enter gives control back to the
//! mission; Escape also quits, without a stop.

use std::io::{IsTerminal as _, Write as _};
use std::time::Duration;

use crossterm::event::{self, KeyCode, KeyEventKind, KeyModifiers};
use crossterm::terminal;
use tokio::sync::mpsc;
use tokio::time::{Instant, MissedTickBehavior};
use zenav_cloud::operator::LeaseSession;
use zenav_protocol::bus::{Bus, Latest, Publisher};
use zenav_protocol::geometry::Twist2;
use zenav_protocol::messages::{EdgeState, InfoRequest, LostPolicy, ModeRequest, Odometry, Teleop};
use zenav_protocol::time::Stamp;
use zenav_protocol::topics;

use super::keyboard::{Command, Keyboard, command_of};
use super::status::{self, OLD, View};
use super::{ended, holder, stop};
use crate::arguments::positive;
use crate::connect::{self, LinkArgs, RobotArgs};
use crate::drawing;
use crate::exit_code;
use crate::failure::{Failure, Outcome};

/// Period of twists.
const PERIOD: Duration = Duration::from_millis(50);
/// Longest time spent on the final stop.
const LEAVE_WITHIN: Duration = Duration::from_secs(2);
/// Longest wait for the robot's answer to a key.
const ASK_WITHIN: Duration = Duration::from_secs(1);
/// Top speeds for a robot that does not report its own, m/s and rad/s.
const CAREFUL: Twist2 = Twist2 { v: 0.3, w: 1.0 };

const HELP: [&str; 2] = [
    "Space take control and stop   Enter give back   W A S D (Q E) drive   + - speed",
    "R resume   Ctrl-C stop and leave   Esc leave without a stop",
];

/// Keyboard teleoperation.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  zenav teleop\n  zenav teleop --robot anna --connect tcp/127.0.0.1:7450\n\nSpace takes control and stops, Enter gives it back, W A S D drive while held (Q E in curves), + and - set the speed, R releases a stop. Ctrl-C leaves the robot stopped; `zenav resume` releases it. Escape gives control back and leaves without a stop."
)]
pub struct TeleopArgs {
    #[command(flatten)]
    robot: RobotArgs,
    /// Top speed, m/s [default: the robot's]
    #[arg(long, value_name = "M/S", value_parser = positive)]
    speed: Option<f64>,
    /// Top yaw rate, rad/s [default: the robot's]
    #[arg(long, value_name = "RAD/S", value_parser = positive)]
    turn: Option<f64>,
}

/// Drives from the keyboard until Ctrl-C.
///
/// # Errors
/// [`exit_code::USAGE`] without a terminal; a later failure is returned after the robot was stopped.
pub fn teleop(args: &TeleopArgs) -> Outcome {
    if !std::io::stdin().is_terminal() {
        return Err(Failure::usage("teleop needs a terminal: its keys drive the robot"));
    }
    let robot = RobotArgs {
        link: args.robot.link.with_robot(),
        ..args.robot.clone()
    };
    let patience = robot.link.patience();
    let mut last = robot.link.clone();
    last.timeout = last.timeout.min(LEAVE_WITHIN.as_secs_f64());
    connect::on_robot(&robot, async |bus, robot| {
        let top = top_speeds(&bus, &robot, patience).await;
        let top = Twist2::new(args.speed.unwrap_or(top.v), args.turn.unwrap_or(top.w));
        let screen = RawTerminal::open()?;
        let mut session = Session::new(&bus, &robot, top)?;
        session.alone = alone(&bus, &robot).await;
        let driven = session.run(keys()).await;
        if matches!(driven, Ok(Leaving::AsItIs)) {
            session.act(Command::Give).await;
            drop(screen);
            return Ok(exit_code::OK);
        }
        let stopped = session.leave(&last).await;
        drop(screen);
        stopped?;
        crate::output::note(format_args!(
            "{robot} is stopped; `zenav resume --robot {robot}` releases it"
        ));
        driven.map(|_| exit_code::OK)
    })
}

/// Top speeds that the robot reports.
async fn top_speeds(bus: &Bus, robot: &str, within: Duration) -> Twist2 {
    match bus.ask(&topics::EDGE_INFO, &[robot], &InfoRequest {}, within).await {
        Ok(info) => info.model.map_or(CAREFUL, |model| {
            Twist2::new(model.drive.top_speed(), model.drive.top_yaw_rate())
        }),
        Err(error) => {
            tracing::warn!(%error, "the robot does not tell its limits; driving carefully");
            CAREFUL
        }
    }
}

/// The robot's policy after loss of its commander.
async fn alone(bus: &Bus, robot: &str) -> Option<LostPolicy> {
    let mode = bus
        .ask(&topics::MODE, &[robot], &ModeRequest::default(), ASK_WITHIN)
        .await;
    mode.ok().map(|mode| mode.on_lost)
}

/// The terminal in raw mode until dropped, panics included.
struct RawTerminal;

impl RawTerminal {
    fn open() -> Result<Self, Failure> {
        terminal::enable_raw_mode()?;
        Ok(Self)
    }
}

impl Drop for RawTerminal {
    fn drop(&mut self) {
        // Nothing can be done if the terminal is gone.
        let _ = terminal::disable_raw_mode();
        crate::output::note("");
    }
}

/// Commands as typed; ends when the terminal does.
fn keys() -> mpsc::UnboundedReceiver<Command> {
    let (sender, receiver) = mpsc::unbounded_channel();
    std::thread::spawn(move || {
        while let Ok(event) = event::read() {
            let event::Event::Key(key) = event else { continue };
            if key.kind == KeyEventKind::Release {
                continue;
            }
            let control = key.modifiers.contains(KeyModifiers::CONTROL);
            let found = match key.code {
                KeyCode::Char(letter) => command_of(letter, control),
                KeyCode::Enter => command_of('\n', false),
                KeyCode::Esc => Some(Command::Leave),
                KeyCode::Up => command_of('w', false),
                KeyCode::Down => command_of('s', false),
                KeyCode::Left => command_of('a', false),
                KeyCode::Right => command_of('d', false),
                _ => None,
            };
            if found.is_some_and(|found| sender.send(found).is_err()) {
                return;
            }
        }
    });
    receiver
}

/// How a session ends.
enum Leaving {
    /// The robot was stopped.
    Stopped,
    /// The robot continues as it is.
    AsItIs,
}

/// A teleoperation session.
struct Session {
    bus: Bus,
    robot: String,
    holder: String,
    keyboard: Keyboard,
    states: Latest<EdgeState>,
    /// Source of stamps: published every tick of the robot, five times as often as its state.
    odometry: Latest<Odometry>,
    teleop: Publisher<Teleop>,
    held: Option<LeaseSession>,
    seen: Option<(Instant, EdgeState)>,
    echo: Option<Stamp>,
    /// The robot's policy after loss of its commander.
    alone: Option<LostPolicy>,
    /// The last note printed.
    note: String,
    start: Instant,
}

impl Session {
    fn new(bus: &Bus, robot: &str, top: Twist2) -> Result<Self, Failure> {
        Ok(Self {
            bus: bus.clone(),
            robot: robot.to_owned(),
            holder: holder(),
            keyboard: Keyboard::new(top),
            states: bus.latest(&topics::STATE, &[robot])?,
            odometry: bus.latest(&topics::ODOMETRY, &[robot])?,
            teleop: bus.publisher(&topics::TELEOP, &[robot])?,
            held: None,
            seen: None,
            echo: None,
            alone: None,
            note: String::new(),
            start: Instant::now(),
        })
    }

    /// Runs until the user quits by key or signal, or the terminal is gone.
    async fn run(&mut self, mut keys: mpsc::UnboundedReceiver<Command>) -> Result<Leaving, Failure> {
        eprint!("{}\r\n", HELP.join("\r\n"));
        let mut pace = tokio::time::interval(PERIOD);
        pace.set_missed_tick_behavior(MissedTickBehavior::Skip);
        let ended = ended();
        tokio::pin!(ended);
        loop {
            tokio::select! {
                biased;
                () = &mut ended => return Ok(Leaving::Stopped),
                key = keys.recv() => match key {
                    None | Some(Command::Quit) => return Ok(Leaving::Stopped),
                    Some(Command::Leave) => return Ok(Leaving::AsItIs),
                    Some(command) => self.act(command).await,
                },
                _ = pace.tick() => {
                    self.hear();
                    self.drive();
                    self.draw();
                }
            }
        }
    }

    async fn act(&mut self, command: Command) {
        if !matches!(command, Command::Move { .. }) {
            // A repeated command prints its note again; a key held down prints it once.
            self.note.clear();
        }
        match command {
            Command::Take => self.take().await,
            Command::Give => {
                self.keyboard.rest();
                self.drive();
                if let Some(held) = self.held.take()
                    && let Err(error) = held.release().await
                {
                    self.tell(format!("control not released ({error}); it expires by itself"));
                }
            }
            Command::Move { .. } if self.held.is_none() => self.tell("Space takes control first".to_owned()),
            Command::Move { forward, left } => self.keyboard.press(self.start.elapsed(), forward, left),
            Command::Faster => self.keyboard.scale(true),
            Command::Slower => self.keyboard.scale(false),
            Command::Resume => {
                let asked = stop::release(&self.bus, &self.robot, self.holder.clone(), ASK_WITHIN).await;
                if let Err(error) = asked {
                    self.tell(format!("not resumed: {error}"));
                }
            }
            Command::Quit | Command::Leave => {}
        }
    }

    /// Stops, and takes control unless it is certain to be held here already.
    async fn take(&mut self) {
        self.keyboard.rest();
        self.drive();
        self.hear();
        if self.held.is_some() && self.seen.as_ref().is_some_and(|(at, _)| at.elapsed() <= OLD) {
            return;
        }
        self.held = None;
        match LeaseSession::acquire(&self.bus, &self.robot, &self.holder, ASK_WITHIN).await {
            Ok(held) => {
                // Anything queued here was sent before the grant.
                self.hear();
                self.held = Some(held);
            }
            Err(error) => self.tell(format!("no control: {error}")),
        }
    }

    /// Takes in the robot's newest stamp and state; the state decides who commands.
    fn hear(&mut self) {
        let odometry = self.odometry.take().map(|odometry| odometry.stamp);
        let state = self.states.take();
        // After a restart the robot's stamps may start anew: the latest received counts, not the greatest.
        self.echo = odometry.max(state.as_ref().map(|state| state.stamp)).or(self.echo);
        let Some(state) = state else { return };
        if let Some(held) = &self.held
            && let Some(why) = status::lost(&held.grant, &self.holder, &state)
        {
            self.held = None;
            self.keyboard.rest();
            self.tell(format!("{why}; Space takes it again"));
        }
        self.seen = Some((Instant::now(), state));
    }

    fn drive(&self) {
        if let (Some(held), Some(echo)) = (&self.held, self.echo) {
            self.teleop.put(&Teleop {
                epoch: held.grant.epoch,
                twist: self.keyboard.twist(self.start.elapsed()),
                echo,
            });
        }
    }

    /// Prints a note on a line of its own above the status line; a repeat is suppressed until the next command.
    fn tell(&mut self, note: String) {
        if note != self.note {
            eprint!("\r{note}\x1b[K\r\n");
            self.note = note;
        }
    }

    fn draw(&self) {
        let width = drawing::terminal::size().map_or(80, |(columns, _)| columns);
        // Back to the start of the line, and clear its rest; one write, to avoid flicker.
        let line = format!("\r{}\x1b[K", status::cut(&self.status(), width));
        let _ = std::io::stderr().write_all(line.as_bytes());
    }

    fn status(&self) -> String {
        let Some((at, state)) = &self.seen else {
            return format!("{}: nothing heard yet", self.robot);
        };
        let view = View {
            robot: &self.robot,
            held: self.held.as_ref().map(|held| &held.grant),
            age: at.elapsed(),
            state,
            limit: self.keyboard.limit(),
        };
        view.line()
    }

    /// Leaves the robot stopped, whoever was in command, over every endpoint in `link`.
    async fn leave(&mut self, link: &LinkArgs) -> Result<(), Failure> {
        self.keyboard.rest();
        self.drive();
        stop::everywhere(&self.bus, link, &self.robot).await.map_err(|error| {
            let heard = self.seen.as_ref().map(|(at, state)| (at.elapsed(), state));
            let robot = &self.robot;
            let known = status::unstopped(self.held.is_some(), self.alone, heard);
            let text = format!(
                "{robot} did not confirm its stop ({error}): {known}. `zenav stop --robot {robot} --connect ENDPOINT` with the robot's own endpoint needs no router"
            );
            Failure::new(error.code, text)
        })?;
        if let Some(held) = self.held.take() {
            // If this fails, the lease expires unrenewed.
            let _ = held.release().await;
        }
        Ok(())
    }
}
