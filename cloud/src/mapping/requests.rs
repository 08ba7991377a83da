//! Requests. What does mapping answer, and how is a repeated request carried out only once?

use std::collections::VecDeque;

use zenav_protocol::bus::Request;
use zenav_protocol::messages::{MapAction, MapReply, MapRequest, Refusal};
use zenav_protocol::time::Stamp;

use super::{Service, storage};

/// Most answers that are kept for repeated requests.
const MAX_ANSWERS: usize = 64;

type Answer = Result<MapReply, Refusal>;

/// First answers by request id, newest first: a repeated request gets the first answer and changes nothing.
#[derive(Debug, Default)]
pub(super) struct FirstAnswers(VecDeque<(String, Answer)>);

impl FirstAnswers {
    fn get(&self, id: Option<&str>) -> Option<Answer> {
        let (_, answer) = self.0.iter().find(|(known, _)| Some(known.as_str()) == id)?;
        Some(answer.clone())
    }

    fn keep(&mut self, id: Option<String>, answer: &Answer) {
        if let Some(id) = id {
            self.0.truncate(MAX_ANSWERS - 1);
            self.0.push_front((id, answer.clone()));
        }
    }
}

impl Service {
    pub(super) async fn answer(&mut self, request: Request<MapRequest, MapReply>, now: Stamp) {
        let MapRequest {
            action,
            request_id,
            epoch,
        } = request.body.clone();
        if action == MapAction::Get {
            self.hand_out(request);
            return;
        }
        let answer = match self.answered.get(request_id.as_deref()) {
            Some(first) => first,
            // A refusal for want of authority changed nothing: it is not kept, and the same request may succeed later.
            None => match self.authority.admit(now, epoch) {
                Err(refusal) => Err(refusal),
                Ok(()) => {
                    let answer = self.act(action, now).await;
                    self.answered.keep(request_id, &answer);
                    answer
                }
            },
        };
        match answer {
            Ok(reply) => request.reply(&reply),
            Err(refusal) => request.refuse(&refusal),
        }
    }

    async fn act(&mut self, action: MapAction, now: Stamp) -> Answer {
        match action {
            MapAction::Get => {}
            MapAction::Save => self.save().await?,
            MapAction::Reset => self.core.reset(storage::new_map_id(&self.config.robot)),
            MapAction::Resume => self.core.mapper.resume(),
            MapAction::Hold => self.core.mapper.hold(),
            MapAction::Forget => self.core.mapper.decay_now(),
        }
        self.publish(now);
        let info = self.core.mapper.info();
        self.info.put(&info);
        Ok(MapReply {
            info,
            values: Vec::new(),
            trajectory: Vec::new(),
        })
    }
}
