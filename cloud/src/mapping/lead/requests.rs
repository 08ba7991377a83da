//! Requests. How does the mapping service that leads answer requests? A repeated one is carried out only once.

use std::collections::VecDeque;

use zenav_protocol::bus::Call;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::{
    AnnotateAction, AnnotateRequest, Annotations, GoalPoint, LocaliseAction, LocaliseReply, LocaliseRequest, MapAction,
    MapReply, MapRequest, Refusal, StoredMapInfo,
};
use zenav_protocol::time::Stamp;
use zenav_protocol::topics::{MappingReply, MappingRequest};

use super::super::storage;
use super::Leadership;

/// Most answers kept for repeated requests.
const MAX_ANSWERS: usize = 64;

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
    /// Answers one request. A new ask is a new arm here.
    pub(super) async fn answer(&mut self, call: Call<MappingRequest>, now: Stamp) {
        let Call { request, responder } = call;
        let answer = match request {
            // Encoding a whole map takes a while: the reply comes later.
            MappingRequest::Map(MapRequest {
                action: MapAction::Get, ..
            }) => return self.hand_out(responder),
            MappingRequest::Map(request) => self.control_map(request, now).await.map(MappingReply::Map),
            MappingRequest::Localise(request) => self.localise(&request, now).map(MappingReply::Localise),
            MappingRequest::Annotate(request) => self.annotate(request, now).await.map(MappingReply::Annotate),
        };
        responder.send(answer);
    }

    /// Lists the stored maps, or carries out a change once.
    async fn control_map(&mut self, request: MapRequest, now: Stamp) -> Result<MapReply, Refusal> {
        if request.action == MapAction::List {
            let stored = self.stored_maps().await?;
            return Ok(self.described(stored));
        }
        if let Some(first) = self.answered.get(request.request_id.as_deref()) {
            return first;
        }
        // A refusal for lack of authority changed nothing: it is not kept, and the same request may succeed later.
        self.authority.admit(now, request.epoch)?;
        let answer = self.act(&request, now).await;
        self.answered.keep(request.request_id, &answer);
        answer
    }

    /// The localisation health, after setting the pose or starting a search if requested.
    fn localise(&mut self, request: &LocaliseRequest, now: Stamp) -> Result<LocaliseReply, Refusal> {
        if request.action != LocaliseAction::Report {
            self.authority.admit(now, request.epoch)?;
        }
        match request.action {
            LocaliseAction::Report => {}
            LocaliseAction::At => self.place(request.pose)?,
            LocaliseAction::Global => self.look_everywhere()?,
        }
        Ok(LocaliseReply {
            health: self.core.health(),
        })
    }

    /// The annotations, after a change if requested; a change is carried out once, under the lease in force.
    async fn annotate(&mut self, request: AnnotateRequest, now: Stamp) -> Result<Annotations, Refusal> {
        if request.action == AnnotateAction::Get {
            return Ok(self.annotations.now().clone());
        }
        if let Some(first) = self.annotated.get(request.request_id.as_deref()) {
            return first;
        }
        self.authority.admit(now, request.epoch)?;
        if self.is_locked_out {
            return Err(Refusal::rejected(
                "places and zones cannot be stored: the mapping service that led before is suspended and locks the folder; end it, and \
                 restart this one",
            ));
        }
        // A successor of this process would carry a change over again if it continued in an older frame.
        if self.session.frame() != self.core.mapper.map().frame {
            let _ = self.keep(now, true).await;
        }
        let changed = self.annotations.change(request.action).await;
        if changed == Ok(true) {
            self.outbox.annotations.put(self.annotations.now());
        }
        let answer = changed.map(|_| self.annotations.now().clone());
        self.annotated.keep(request.request_id, &answer);
        answer
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

    async fn act(&mut self, request: &MapRequest, now: Stamp) -> Result<MapReply, Refusal> {
        match request.action {
            MapAction::Get | MapAction::List => {}
            MapAction::Save => {
                self.save(request.name.as_deref(), now).await?;
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
