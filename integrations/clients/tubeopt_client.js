// A client of `tubeopt serve`, for a browser or for Node 22 and newer (20 with --experimental-websocket).
//
//     const robot = await Robot.connect(token, { onState: (state) => console.log(state.margin) });
//     robot.enable();
//     setInterval(() => robot.servoCp([0.05, 0, 0.15]), 20);

export class Robot {
  static connect(token, { port = 8765, role = "commander", onState = () => {}, onError = console.error, onEvent = () => {} } = {}) {
    return new Promise((resolve, reject) => {
      const socket = new WebSocket(`ws://127.0.0.1:${port}`);
      const robot = new Robot(socket);
      socket.onopen = () => robot.send({ op: "hello", token, role });
      socket.onclose = (event) => reject(new Error(event.reason || "closed"));
      socket.onmessage = (event) => {
        const told = JSON.parse(event.data);
        if (told.op === "welcome") resolve(robot);
        else if (told.op === "state") onState(told, robot);
        else if (told.op === "error") onError(told.words);
        else onEvent(told.op, told.words); // "warning" or "status"
      };
    });
  }

  constructor(socket) {
    this.socket = socket;
  }

  send(message) {
    this.socket.send(JSON.stringify(message));
  }

  enable() {
    this.send({ op: "state_command", command: "enable" });
  }

  // To be called again and again: the robot holds where it hears nothing for a tenth of a second.
  servoCp(position, direction = null) {
    this.send({ op: "servo_cp", position, direction });
  }

  servoCv(linear) {
    this.send({ op: "servo_cv", linear });
  }

  moveCp(position, direction = null) {
    this.send({ op: "move_cp", position, direction });
  }
}
