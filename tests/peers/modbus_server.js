// The controller's words and outputs in npm's modbus-serial; every write is told on stdout as one JSON line.
// Usage: node modbus_server.js PORT; stdin: one JSON line {"word": address, "values": [...]} a change.
const modbus = require("modbus-serial");
const registers = new Uint16Array(65536);
const coils = new Uint8Array(512);
const told = (what) => process.stdout.write(JSON.stringify(what) + "\n");
const unit = {
  getHoldingRegister: (address) => registers[address],
  setRegister: (address, value) => { registers[address] = value; told({ register: address, value }); },
  getCoil: (address) => Boolean(coils[address]),
  setCoil: (address, value) => { coils[address] = Number(value); told({ coil: address, value: Boolean(value) }); },
  getDiscreteInput: (address) => address === 1,
};
const server = new modbus.ServerTCP(unit, { host: "127.0.0.1", port: Number(process.argv[2]), unitID: 1 });
server.on("initialized", () => told({ listening: true }));
require("readline").createInterface({ input: process.stdin }).on("line", (line) => {
  const { word, values } = JSON.parse(line);
  values.forEach((value, i) => { registers[word + i] = value; });
});
