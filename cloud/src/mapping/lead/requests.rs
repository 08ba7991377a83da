//! Requests. Answers of the mapping service; a repeated request is carried out only once.

use std::collections::VecDeque;

use zenav_protocol::bus::Request;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::{
    GoalPoint, LocaliseAction, LocaliseReply, LocaliseRequest, MapAction, MapReply, MapRequest, Refusal, StoredMapInfo,
};
use zenav_protocol::time::Stamp;

use super::super::storage;
use super::Leadership;

/// Most answers kept for repeated requests.
const MAX_ANSWERS: usize = 64;

type Answer = Result<MapReply, Refusal>;

/// First answers by request id, newest first: a repeated request gets the first answer and changes nothing.
#[derive(Debug)]
pub(super) struct FirstAnswers<R>(VecDeque<(String, Result<R, Refusal>)>);

// Not derived: the derive would require `R: Default`.
impl<R> Default for FirstAnswers<R> {
    fn default() -> Self {
        Self(VecDeque::new())
    }
}

impl<R: Clone> FirstAnswers<R> {
    pub(super) fn get(&self, id: Option<&str>) -> Option<Result<R, Refusal>> {
        let (_, answer) = self.0.iter().find(|(known, _)| Some(known.as_str()) == id)?;
        Some(answer.clone())
    }

    pub(super) fn keep(&mut self, id: Option<String>, answer: &Result<R, Refusal>) {
        if let Some(id) = id {
            self.0.truncate(MAX_ANSWERS - 1);
            self.0.push_front((id, answer.clone()));
        }
    }
}

impl Leadership {
    pub(super) async fn answer(&mut self, request: Request<MapRequest, MapReply>, now: Stamp) {
        match request.body.action {
            MapAction::Get => return self.hand_out(request),
            MapAction::List => {
                return match self.list().await {
                    Ok(reply) => request.reply(&reply),
                    Err(refusal) => request.refuse(&refusal),
                };
            }
            _ => {}
        }
        let id = request.body.request_id.clone();
        let answer = match self.answered.get(id.as_deref()) {
            Some(first) => first,
            // A refusal for lack of authority changed nothing: it is not kept, and the same request may succeed later.
            None => match self.authority.admit(now, request.body.epoch) {
                Err(refusal) => Err(refusal),
                Ok(()) => {
                    let answer = self.act(&request.body, now).await;
                    self.answered.keep(id, &answer);
                    answer
                }
            },
        };
        match answer {
            Ok(reply) => request.reply(&reply),
            Err(refusal) => request.refuse(&refusal),
        }
    }

    /// Answers with the localisation health, after setting the pose or starting a search if requested.
    pub(super) fn answer_place(&mut self, request: Request<LocaliseRequest, LocaliseReply>, now: Stamp) {
        let LocaliseRequest { action, pose, epoch } = request.body.clone();
        let done = match action {
            LocaliseAction::Report => Ok(()),
            LocaliseAction::At | LocaliseAction::Global => {
                self.authority.admit(now, epoch).and_then(|()| match action {
                    LocaliseAction::Global => self.look_everywhere(),
                    _ => self.place(pose),
                })
            }
        };
        match done {
            Ok(()) => request.reply(&LocaliseReply {
                health: self.core.health(),
            }),
            Err(refusal) => request.refuse(&refusal),
        }
    }

    fn look_everywhere(&mut self) -> Result<(), Refusal> {
        // Told before the next scan: the robot does not drive by a pose that is being searched for.
        if let Some(localisation) = self.core.look_everywhere()? {
            self.outbox.localisation.put(&localisation);
        }
        Ok(())
    }

    fn place(&mut self, pose: Option<Pose2>) -> Result<(), Refusal> {
        let Some(pose) = pose.filter(Pose2::is_finite) else {
            return Err(Refusal::rejected(
                "expected `pose` with finite numbers, as in {\"action\": \"at\", \"pose\": {\"x\": 1.0, \"y\": 2.0, \"yaw\": 0.0}}",
            ));
        };
        let at = GoalPoint {
            x: pose.x,
            y: pose.y,
            yaw: Some(pose.yaw),
        };
        at.checked().map_err(Refusal::bad_request)?;
        let correction = self.core.place(pose)?;
        self.outbox.corrections.put(&correction);
        Ok(())
    }

    async fn act(&mut self, request: &MapRequest, now: Stamp) -> Answer {
        match request.action {
            MapAction::Get | MapAction::List => {}
            MapAction::Save => {
                self.save(request.name.as_deref()).await?;
                if request.name.is_none() {
                    self.keep(now, true).await?;
                }
            }
            MapAction::Load => self.load(request, now).await?,
            MapAction::Reset => {
                self.forget_session(now).await?;
                self.core.reset(storage::new_map_id(&self.config.robot));
            }
            MapAction::Resume => self.core.mapper.resume(),
            MapAction::Hold => self.core.mapper.hold(),
            MapAction::Forget => self.core.mapper.decay_now(),
        }
        self.publish(now);
        self.tell_info();
        self.tell_graph(now);
        Ok(self.described(Vec::new()))
    }

    async fn list(&self) -> Answer {
        let stored = self.stored_maps().await?;
        Ok(self.described(stored))
    }

    /// The map without its cells.
    fn described(&self, stored: Vec<StoredMapInfo>) -> MapReply {
        MapReply {
            info: self.core.mapper.info(),
            values: Vec::new(),
            trajectory: Vec::new(),
            stored,
        }
    }
}
